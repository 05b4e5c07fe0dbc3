"""Where things stand in the joint state vector.

One vector holds the agent, the anchors and the walls of one hypothesis, in the
*gauge frame*: RP is the origin and the x axis points at the VRP of the reference
wall (slot 0), whose y coordinate is therefore zero without uncertainty. The angle
``theta`` from the gauge frame's x axis to its expected direction in the
estimator's frame is one more state: path delays do not depend on it, so passive
measurements cannot make the filter believe that they tell the rotation of the map.

    [x, y, vx, vy, theta, (x, y, w, b) per anchor, (x, y) per wall slot]

``w`` is the squared height difference of anchor and agent, square metres: a path of
horizontal length d is ``sqrt(d^2 + w)`` long. ``b`` is the anchor's clock bias, metres: it
adds to every path length.

Where features are virtual anchors (method ``va``: each anchor has its own), a slot holds
``(r, phi, cx, cy)`` instead: the virtual anchor stands at distance ``r`` and bearing ``phi`` from
``c``, a constant: where the agent was when it was found. A path length tells ``r`` at once and
``phi`` only as the agent moves on: in these coordinates what is known is a Gaussian from the first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

__all__ = ["Layout"]


@dataclass(frozen=True)
class Layout:
    """Index arithmetic of the state vector.

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

    AGENT = slice(0, 4)
    POSITION = slice(0, 2)
    THETA = 4
    FIRST_ANCHOR = 5
    PER_ANCHOR = 4

    @classmethod
    @cache
    def of(cls, anchors: int, slots: int, shared: bool = True) -> Layout:
        """The layout of so many anchors and slots, one object that keeps its numbers."""
        return cls(anchors, slots, shared)

    @cached_property
    def size(self) -> int:
        """Length n of the state vector."""
        return self.FIRST_ANCHOR + self.PER_ANCHOR * self.anchors + self.per_slot * self.slots

    @cached_property
    def per_slot(self) -> int:
        """Coordinates of a slot."""
        return 2 if self.shared else 4

    @cached_property
    def pairs(self) -> int:
        """Ordered pairs of walls, L * L; virtual anchors have none."""
        return self.slots**2 if self.shared else 0

    @cached_property
    def features(self) -> int:
        """Path features per anchor: line of sight, L walls or virtual anchors, pairs of walls."""
        return 1 + self.slots + self.pairs

    def anchor(self, k: int) -> slice:
        """x, y, w, b of anchor ``k``."""
        begin = self.FIRST_ANCHOR + self.PER_ANCHOR * k
        return slice(begin, begin + self.PER_ANCHOR)

    def anchor_xy(self, k: int) -> slice:
        """x, y of anchor ``k``."""
        begin = self.anchor(k).start
        return slice(begin, begin + 2)

    def height2(self, k: int) -> int:
        """W of anchor ``k``."""
        return self.FIRST_ANCHOR + self.PER_ANCHOR * k + 2

    def bias(self, k: int) -> int:
        """B of anchor ``k``."""
        return self.FIRST_ANCHOR + self.PER_ANCHOR * k + 3

    def wall(self, slot: int) -> slice:
        """x, y of the VRP in ``slot``, or r, phi, cx, cy of the virtual anchor."""
        begin = self.walls.start + self.per_slot * slot
        return slice(begin, begin + self.per_slot)

    @cached_property
    def walls(self) -> slice:
        """All slots, reshapes to (L, 2); of virtual anchors (L, 4)."""
        return slice(self.FIRST_ANCHOR + self.PER_ANCHOR * self.anchors, self.size)
