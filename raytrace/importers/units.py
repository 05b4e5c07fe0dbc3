"""The unit of a drawing: as told, as its header says, or as its walls and doors suggest.

Headers lie: a drawing in centimetres is often marked as one in millimetres, or not at all. Walls
tell the unit within a factor of a few (half of their length stands in pieces of some metres, and
half of the pieces are shorter than a metre), and the swings of doors within a third. A header that makes the
walls of mice or giants is overruled, aloud; a missing one is replaced only where one unit is much
likelier than any other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from raytrace.importers.options import UNITS_M

__all__ = ["Measures", "Unit", "UnitConfig", "choose_unit", "questioned"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class UnitConfig:
    """What plans usually measure, metres.

    Parameters
    ----------
    smallest_m, largest_m : float
        A plan that is narrower or wider than this in its longer extent is questioned.
    shortest_m, longest_m : float
        Half of the walls' length stands in pieces longer than the first and shorter than the second.
    wall_m, piece_m, swing_m : float
        The usual length in whose pieces half of the walls stand, that of the median piece, and
        the usual radius of a door's swing.
    pieces, swings : int
        Fewer than these tell nothing.
    margin : float
        By how much (natural logarithm of a factor, summed over the measures) a unit must fit better
        than any other to be taken.
    """

    smallest_m: float = 3.0
    largest_m: float = 1000.0
    shortest_m: float = 0.5
    longest_m: float = 120.0
    wall_m: float = 4.0
    piece_m: float = 0.6
    swing_m: float = 0.9
    pieces: int = 50
    swings: int = 2
    margin: float = 0.5
    candidates: Mapping[str, float] = field(
        default_factory=lambda: {name: UNITS_M[name] for name in ("m", "cm", "mm", "in", "ft")}
    )


@dataclass(frozen=True, eq=False)
class Measures:
    """What was measured in a drawing, in its own unit.

    Parameters
    ----------
    pieces : ndarray, shape (n,)
        Lengths of straight pieces of walls.
    extent : tuple of float
        Width and depth of all walls.
    swings : ndarray, shape (m,)
        Radii of arcs that look like the swings of doors.
    """

    pieces: Array
    extent: tuple[float, float]
    swings: Array

    def half_length(self) -> float:
        """Half of the walls' length stands in pieces longer than this."""
        ordered = np.sort(self.pieces)
        return (
            float(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())]) if len(ordered) else 0.0
        )


@dataclass(frozen=True)
class Unit:
    """A unit, how it was found, and what is doubtful about it (empty if nothing is)."""

    name: str
    note: str
    warning: str = ""

    @property
    def metres(self) -> float:
        """Length of the unit, metres."""
        return UNITS_M[self.name]


def choose_unit(
    measures: Measures, stated: str | None, told: str | None, field_: str, config: UnitConfig | None = None
) -> Unit:
    """The unit of a drawing.

    Parameters
    ----------
    measures : Measures
        What was measured in it.
    stated, told : str or None
        What the file says, and what the user says, who is always right.
    field_ : str
        Where the file says it and what came there, for messages.
    config : UnitConfig, optional
        What plans usually measure.

    Raises
    ------
    FileFormatError
        If the file states none and the walls do not tell.
    """
    config = UnitConfig() if config is None else config
    if told is not None:
        return Unit(told, f"unit {told}, as told", questioned(measures.extent, UNITS_M[told], told, config))
    likely = _likeliest(measures, config)
    if stated is not None:
        doubt = _doubt(measures, stated, config)
        if not doubt or likely in (None, stated):
            return Unit(stated, f"unit {stated}, from the header", doubt)
        assert likely is not None
        return Unit(
            likely,
            f"unit {likely}, as the walls suggest",
            f"{doubt}; {likely} is taken instead, which makes {_span(measures.extent, UNITS_M[likely])}: "
            f"--unit {stated} insists",
        )
    if likely is None:
        field_name, _, came = field_.partition(": ")
        spans = [f"{name}: {_span(measures.extent, UNITS_M[name])}" for name in config.candidates]
        raise FileFormatError(
            f"{field_name}: expected a unit among {', '.join(UNITS_M)}, got {came}; give one with --unit "
            f"({'; '.join(spans)})"
        )
    return Unit(
        likely,
        f"unit {likely}, as the walls suggest",
        f"the file states no unit: {likely} is taken, which makes the plan "
        f"{_span(measures.extent, UNITS_M[likely])}; --unit overrules it",
    )


def questioned(
    extent: tuple[float, float], metres: float, unit: str, config: UnitConfig | None = None
) -> str:
    """Why a plan of some extent in a unit is doubtful; empty if it is not."""
    config = UnitConfig() if config is None else config
    longer = max(extent) * metres
    if config.smallest_m <= longer <= config.largest_m:
        return ""
    return f"unit {unit} makes the plan {_span(extent, metres)}"


def _doubt(measures: Measures, unit: str, config: UnitConfig) -> str:
    doubt = questioned(measures.extent, UNITS_M[unit], unit, config)
    half = measures.half_length() * UNITS_M[unit]
    if (
        not doubt
        and len(measures.pieces) >= config.pieces
        and not config.shortest_m <= half <= config.longest_m
    ):
        doubt = f"unit {unit} makes half of the walls stand in pieces of {half:.3g} m"
    return doubt


def _likeliest(measures: Measures, config: UnitConfig) -> str | None:
    """The unit that fits much better than any other, if one does."""
    if len(measures.pieces) < config.pieces:
        return None
    pairs = [(measures.half_length(), config.wall_m), (float(np.median(measures.pieces)), config.piece_m)]
    misfit = {}
    for name, metres in config.candidates.items():
        off = sum(abs(np.log(found * metres / usual)) for found, usual in pairs)
        if len(measures.swings) >= config.swings:
            off += 3.0 * abs(np.log(float(np.median(measures.swings)) * metres / config.swing_m))
        misfit[name] = off if not _doubt(measures, name, config) else np.inf
    best, second = sorted(misfit, key=misfit.__getitem__)[:2]
    return best if misfit[second] - misfit[best] >= config.margin else None


def _span(extent: tuple[float, float], metres: float) -> str:
    return f"{extent[0] * metres:.3g} m by {extent[1] * metres:.3g} m"
