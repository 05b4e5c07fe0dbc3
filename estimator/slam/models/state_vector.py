"""Where things stand in the joint state vector.

One vector holds the agent, the anchors and the walls of one hypothesis, in the
*gauge frame*: RP is the origin and the x axis points at the VRP of the reference
wall (slot 0), whose y coordinate is therefore zero without uncertainty. The angle
``theta`` from the gauge frame's x axis to its expected direction in the
estimator's frame is one more state: path delays do not depend on it, so passive
measurements cannot make the filter believe that they tell the rotation of the map.

    [x, y, vx, vy, theta, e, psi, (x, y, w, b, s) per anchor, (x, y) per wall slot]

``e`` is the echo bias, metres: all ranges of all sweeps are too long by it, since one front end took them.
``psi`` is the direction of the agent's body in the gauge frame, radians, which odometry turns on.

``w`` is the squared height difference of anchor and agent, square metres: a path of
horizontal length d is ``(1 + s) sqrt(d^2 + w) + b`` long. ``b`` is the anchor's clock bias, metres, and ``s``
its range scale, a share of 1 (:mod:`estimator.slam.models.clocks`).

Where features are virtual anchors (method ``va``: each anchor has its own), a slot holds
``(r, phi, cx, cy)`` instead: the virtual anchor stands at distance ``r`` and bearing ``phi`` from
``c``, a constant: where the agent was when it was found. A path length tells ``r`` at once and
``phi`` only as the agent moves on: in these coordinates what is known is a Gaussian from the first.
"""

from __future__ import annotations

from typing import Final, NamedTuple

__all__ = [
    "AGENT",
    "ECHO_BIAS",
    "FIRST_ANCHOR",
    "HEADING",
    "NOWHERE_M",
    "PER_ANCHOR",
    "POSITION",
    "THETA",
    "Layout",
]

POSITION: Final = slice(0, 2)
AGENT: Final = slice(0, 4)
THETA: Final = 4
ECHO_BIAS: Final = 5
HEADING: Final = 6
FIRST_ANCHOR: Final = 7
PER_ANCHOR: Final = 5
NOWHERE_M: Final = 1e4  # coordinates of unknown anchors and of the VRPs of empty slots


class Layout(NamedTuple):
    """Index arithmetic of the state vector; compiled functions take it as it is.

    Parameters
    ----------
    anchors : int
        Number of anchors, K.
    slots : int
        Number of wall slots, L (some may be empty).
    shared : bool
        Whether slots hold walls common to all anchors, or else virtual anchors.
    """

    anchors: int
    slots: int
    shared: bool = True

    @property
    def per_slot(self) -> int:
        """Coordinates of a slot."""
        return 2 if self.shared else 4

    @property
    def size(self) -> int:
        """Length n of the state vector."""
        return FIRST_ANCHOR + PER_ANCHOR * self.anchors + self.per_slot * self.slots

    @property
    def pairs(self) -> int:
        """Ordered pairs of walls, L * L; virtual anchors have none."""
        return self.slots**2 if self.shared else 0

    @property
    def features(self) -> int:
        """Path features per anchor: line of sight, L walls or virtual anchors, pairs of walls."""
        return 1 + self.slots + self.pairs

    def anchor(self, k: int) -> slice:
        """x, y, w, b of anchor ``k``."""
        begin = FIRST_ANCHOR + PER_ANCHOR * k
        return slice(begin, begin + 4)

    def anchor_xy(self, k: int) -> slice:
        """x, y of anchor ``k``."""
        begin = FIRST_ANCHOR + PER_ANCHOR * k
        return slice(begin, begin + 2)

    def height2(self, k: int) -> int:
        """Index of the squared height difference of anchor ``k``."""
        return FIRST_ANCHOR + PER_ANCHOR * k + 2

    def bias(self, k: int) -> int:
        """Index of the clock bias of anchor ``k``."""
        return FIRST_ANCHOR + PER_ANCHOR * k + 3

    def scale(self, k: int) -> int:
        """Index of the range scale of anchor ``k``."""
        return FIRST_ANCHOR + PER_ANCHOR * k + 4

    @property
    def walls(self) -> slice:
        """All slots, reshapes to (L, 2); of virtual anchors (L, 4)."""
        return slice(FIRST_ANCHOR + PER_ANCHOR * self.anchors, self.size)

    def wall(self, slot: int) -> slice:
        """x, y of the VRP in ``slot``, or r, phi, cx, cy of the virtual anchor."""
        begin = FIRST_ANCHOR + PER_ANCHOR * self.anchors + self.per_slot * slot
        return slice(begin, begin + self.per_slot)
