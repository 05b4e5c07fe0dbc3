"""What an importer finds in a file: lines with a material, points, and a report.

All importers end in a :class:`Drawing` in metres; what follows (double lines to one
surface, corners, placing the agent) is the same for every format.
"""

from __future__ import annotations

import importlib.util
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.errors import BackendError, FileFormatError, InputError

__all__ = [
    "LARGEST_BYTES",
    "Drawing",
    "ImportReport",
    "Line",
    "Opening",
    "Point",
    "require_finite",
    "require_package",
    "require_size",
]

Point = tuple[float, float]

# A file larger than this is not a floor plan.
LARGEST_BYTES = 64 * 2**20
# More lines than this make neither a plan nor, with its images, a finite computation.
MOST_LINES = 20_000
# Coordinates beyond this are survey coordinates in the wrong unit, or nonsense.
FARTHEST_M = 1e8


@dataclass(frozen=True)
class Opening:
    """A door or passage: from jamb to jamb, metres; both the same where only its middle is known."""

    start_m: Point
    end_m: Point


@dataclass(frozen=True)
class Line:
    """A straight piece of wall as drawn.

    Parameters
    ----------
    start_m, end_m : tuple of float
        Ends, metres.
    material : str
        A name of :data:`raytrace.plan.materials.ITU_MATERIALS`.
    height_m : float
        Height above the floor, metres.
    thickness_m : float
        Thickness that the wall gets if nothing in the drawing tells it, metres.
    source : str
        Layer, feature or object that it comes from.
    drawn_m : float
        Distance of the two lines it was collapsed from, metres; 0 for a single line.
    """

    start_m: Point
    end_m: Point
    material: str
    height_m: float
    thickness_m: float
    source: str
    drawn_m: float = 0.0

    @property
    def length_m(self) -> float:
        """Length, metres."""
        return float(np.hypot(self.end_m[0] - self.start_m[0], self.end_m[1] - self.start_m[1]))


@dataclass
class ImportReport:
    """What became of the things in a file, counted by what they were.

    Parameters
    ----------
    kept, dropped, collapsed : Counter of str
        How many of what were taken, left out (with the reason), and made one.
    notes : list of str
        What else a reader should know: units, shifts, what was placed.
    warnings : list of str
        What may be wrong.
    """

    kept: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    collapsed: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """All of it for JSON."""
        return {
            "kept": dict(sorted(self.kept.items())),
            "dropped": dict(sorted(self.dropped.items())),
            "collapsed": dict(sorted(self.collapsed.items())),
            "notes": list(self.notes),
            "warnings": list(self.warnings),
        }

    def lines(self) -> list[str]:
        """All of it for people, a line each."""
        counters = (("kept", self.kept), ("dropped", self.dropped), ("collapsed", self.collapsed))
        counted = [
            f"{verb:<10}{count:>6}  {what}" for verb, c in counters for what, count in sorted(c.items())
        ]
        said = [("note", note) for note in self.notes] + [("warning", text) for text in self.warnings]
        return counted + [f"{kind:<10}{'':>6}  {text}" for kind, text in said]

    def left_out(self, most: int = 6) -> str:
        """What was dropped, the most frequent first, in one line of bearable length."""
        named = [f"{count} {what}" for what, count in self.dropped.most_common(most)]
        more = len(self.dropped) - len(named)
        return ", ".join([*named, *([f"and {more} more kinds"] if more > 0 else [])])


@dataclass
class Drawing:
    """Lines, anchors and a track collected from one file, metres.

    Parameters
    ----------
    lines : list of Line
        Walls as drawn.
    anchors_m : list of (str, tuple)
        Name and place (x, y, z) of the anchors that the file marks; z may be NaN.
    track_m : list of tuple
        Way-points of the agent, if the file draws them.
    space_m : list of list of tuple
        Outlines of where the agent may walk, if the file draws them.
    floor, ceiling : str or None
        Material of a floor or ceiling that the file has.
    openings : list of Opening
        Doors that the file marks.
    georeference : tuple or None
        Name of the coordinate reference system that the file states, and the place in it that is
        the drawing's (0, 0).
    report : ImportReport
        What was kept and dropped.
    """

    lines: list[Line] = field(default_factory=list)
    anchors_m: list[tuple[str, tuple[float, float, float]]] = field(default_factory=list)
    track_m: list[Point] = field(default_factory=list)
    space_m: list[list[Point]] = field(default_factory=list)
    openings: list[Opening] = field(default_factory=list)
    georeference: tuple[str, Point] | None = None
    floor: str | None = None
    ceiling: str | None = None
    report: ImportReport = field(default_factory=ImportReport)

    def add(self, line: Line) -> None:
        """Add a line.

        Raises
        ------
        InputError
            If a coordinate is not finite or absurd, or there are too many lines.
        """
        require_finite((*line.start_m, *line.end_m), line.source)
        if len(self.lines) >= MOST_LINES:
            raise InputError(f"expected at most {MOST_LINES} lines of walls, got more (at {line.source!r})")
        self.lines.append(line)


def require_finite(values: tuple[float, ...], source: str) -> None:
    """Check coordinates in metres; raises InputError that names their source."""
    for value in values:
        if not abs(value) < FARTHEST_M:
            raise InputError(f"{source}: expected finite coordinates below {FARTHEST_M:g} m, got {value:g}")


def require_size(data: bytes) -> bytes:
    """Return a file's contents unless they are empty or larger than any plan.

    Raises
    ------
    FileFormatError
        If there is nothing, or more than 64 MiB.
    """
    if not data.strip():
        raise FileFormatError("expected a drawing, got an empty file")
    if len(data) > LARGEST_BYTES:
        raise FileFormatError(f"expected at most {LARGEST_BYTES >> 20} MiB, got {len(data) / 2**20:.0f} MiB")
    return data


def require_package(name: str) -> None:
    """Raise BackendError, with the remedy, if a package of the extra ``plans`` is missing."""
    if importlib.util.find_spec(name) is None:
        raise BackendError(
            f"expected the package {name!r}, it is not installed: pip install 'hapslam[plans]'"
        )
