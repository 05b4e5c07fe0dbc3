"""What is known and sensed: the published methods as configurations of one engine.

========  ==============  =============  ==========  ======================================
method    anchors         walls at start paths       features
========  ==============  =============  ==========  ======================================
hybrid    unknown         active sensing heard       walls (VRPs), common to all anchors
mva       known           none           heard       walls (VRPs), common to all anchors
va        known           none           heard       virtual anchors, each anchor its own
passive   up to rotation  none           heard       virtual anchors, each anchor its own
active    not needed      active sensing ignored     walls (VRPs)
========  ==============  =============  ==========  ======================================

``mva`` follows E. Leitinger, A. Venus, B. Teague, F. Meyer, "Data fusion for multipath-based
SLAM: combining information from multiple propagation paths", IEEE Trans. Signal Process. 71,
2023; ``va`` and ``passive`` follow E. Leitinger, F. Meyer, F. Hlawatsch, K. Witrisal, F.
Tufvesson, M. Z. Win, "A belief propagation algorithm for multipath-based SLAM", IEEE Trans.
Wireless Commun. 18(12), 2019, the latter without the anchors' positions (Fig. 11 (a), (c)).

What is known besides is used, or a note says that it is not: ``hybrid`` takes the places of known anchors
(``gaussian`` engine), and so walls sensed at the start and known anchors together; ``mva`` and ``va``, as
published, take no walls that are sensed. Walls known from a floor plan are taken by every method whose
features are walls; the others refuse them.

``passive`` knows every anchor's distance from the start (the shortest path) and nothing of
its bearing. Delays alone leave the whole map free to turn about RP and to be mirrored, so
the first anchor is put on a bearing drawn at random and all else follows from it: the
result is right up to that rotation, and may be a mirror image.

``active`` hears nothing after the first epoch. Its walls stay as they were sensed and the
agent is where the motion model takes it: with a velocity that nobody measured, the expected
position stays at the start and its covariance grows. It is the floor that shows what paths
are worth, not a navigation method; repeated beam sweeps would make it one.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from estimator.errors import ConfigurationError, InputError

__all__ = ["METHODS", "PAIRS", "Method", "method_for", "note_unused", "walls_at_start"]

_LOG = logging.getLogger("hapslam")


class _Known(Protocol):
    """What is known before the first epoch, as far as a method may leave it aside."""

    @property
    def walls(self) -> Sequence[Any]:
        """Walls sensed at the start."""

    @property
    def anchors_m(self) -> Any:
        """Places of the anchors, None if they are unknown."""

    @property
    def walls_known(self) -> bool:
        """Whether the walls are known, and not sensed."""


@dataclass(frozen=True)
class Method:
    """What a method knows and senses.

    Parameters
    ----------
    name : str
        Its name.
    anchors : {"unknown", "known", "ring"}
        What is known of the anchors at the start: nothing, their positions, or their
        distance by the shortest path.
    walls : bool
        Whether walls sensed at the start are used.
    paths : bool
        Whether paths are heard.
    shared : bool
        Whether features are walls common to all anchors (VRPs, equal to master virtual
        anchors) or virtual anchors of each anchor.
    """

    name: str
    anchors: Literal["unknown", "known", "ring"]
    walls: bool
    paths: bool
    shared: bool


METHODS = {
    method.name: method
    for method in (
        Method("hybrid", "unknown", walls=True, paths=True, shared=True),
        Method("va", "known", walls=False, paths=True, shared=False),
        Method("mva", "known", walls=False, paths=True, shared=True),
        Method("passive", "ring", walls=False, paths=True, shared=False),
        Method("active", "unknown", walls=True, paths=False, shared=True),
    )
}
PAIRS = (
    ("hybrid", "gaussian"),
    ("hybrid", "particle"),
    ("va", "gaussian"),
    ("va", "particle"),
    ("mva", "gaussian"),
    ("mva", "particle"),
    ("passive", "particle"),
    ("active", "gaussian"),
    ("active", "particle"),
)


def method_for(method: str, engine: str) -> Method:
    """The method, if the engine can run it.

    Raises
    ------
    ConfigurationError
        If the method or the engine is unknown, or there is no such pair; says what exists.
    """
    engines = sorted({pair[1] for pair in PAIRS})
    if method not in METHODS:
        raise ConfigurationError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    if engine not in engines:
        raise ConfigurationError(f"engine: expected one of {', '.join(engines)}, got {engine!r}")
    if (method, engine) not in PAIRS:
        able = ", ".join(name for name, other in PAIRS if other == engine)
        raise ConfigurationError(f"method: expected one of {able} with engine {engine}, got {method!r}")
    return METHODS[method]


def walls_at_start(method: Method, known: _Known) -> Sequence[Any]:
    """The walls that a method starts with: those sensed, if it uses these, or those known from a floor plan.

    Raises
    ------
    InputError
        If walls are known from a floor plan and the method's features are virtual anchors.
    """
    if known.walls_known and not method.shared:
        able = ", ".join(name for name, other in METHODS.items() if other.shared)
        raise InputError(
            f"method {method.name}: expected no walls of a floor plan, for its features are virtual anchors, "
            f"got {len(known.walls)}; {able} take them"
        )
    return known.walls if method.walls or known.walls_known else ()


def note_unused(method: Method, known: _Known, *, anchors_used: bool) -> None:
    """Note aloud what is known and not used by a method.

    Parameters
    ----------
    method : Method
        The method.
    known : Prior
        What is known before the first epoch.
    anchors_used : bool
        Whether the engine uses the places of the anchors.
    """
    if known.walls and not method.walls and not known.walls_known:
        _LOG.info(
            "method %s takes no walls: %d sensed at the start are not used; hybrid takes both",
            method.name,
            len(known.walls),
        )
    if known.anchors_m is not None and not anchors_used:
        _LOG.info("method %s with this engine does not use the known places of the anchors", method.name)
