"""Doors as openings: what is drawn of a door goes, and the wall that was drawn through it is cut.

A door is drawn as a leaf and the arc of its swing, or marked as a line in the wall or a point on it. In most
drawings the wall stops at the jambs, and nothing is left to do; in others it runs through.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from raytrace.importers.drawing import ImportReport, Line, Opening, Point

__all__ = ["Swing", "cut_openings", "swing_openings"]

Array = NDArray[np.float64]

# Leaves of doors of rooms and halls, metres.
_SWING_M = (0.5, 1.5)
# By so much of its radius the leaf may miss the ends of its arc.
_NEAR = 0.1
# An opening in a wall is parallel to it within this, and no piece shorter than this is left beside it.
_PARALLEL = np.sin(np.deg2rad(10.0))
_SHORTEST_M = 0.02
# Width of a door that is marked by a point.
_DOOR_M = 0.9


@dataclass(frozen=True)
class Swing:
    """An arc that may be the swing of a door: its hinge, radius, and both ends, metres."""

    hinge_m: Point
    radius_m: float
    ends_m: tuple[Point, Point]

    @property
    def is_door(self) -> bool:
        """Whether doors have leaves of that size."""
        return _SWING_M[0] <= self.radius_m <= _SWING_M[1]


def swing_openings(
    swings: list[Swing], lines: list[Line], leaves: list[Line], report: ImportReport
) -> tuple[list[Line], list[Opening]]:
    """Lines without the leaves of doors, and where these doors are when they are closed.

    A leaf is drawn open, from the hinge to one end of its arc; the doorway is from the hinge to the
    other. Where no leaf is found, nothing tells which end is which, and the wall stays as drawn.

    Parameters
    ----------
    swings : list of Swing
        Arcs that are doors.
    lines : list of Line
        Walls, among which leaves may be drawn.
    leaves : list of Line
        What is drawn on layers of doors.
    report : ImportReport
        Told how many leaves were taken out of the walls.
    """
    everything = [*lines, *leaves]
    if not swings or not everything:
        return lines, []
    ends = np.array([(line.start_m, line.end_m) for line in everything])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    gone = np.zeros(len(everything), dtype=bool)
    openings = []
    for swing in swings:
        near = _NEAR * swing.radius_m
        hinge = np.linalg.norm(ends - swing.hinge_m, axis=-1) < near
        fits = np.abs(length - swing.radius_m) < near
        for open_, closed in (swing.ends_m, swing.ends_m[::-1]):
            tip = np.linalg.norm(ends - open_, axis=-1) < near
            leaf = fits & ((hinge[:, 0] & tip[:, 1]) | (hinge[:, 1] & tip[:, 0]))
            if leaf.any():
                gone |= leaf
                openings.append(Opening(swing.hinge_m, closed))
                break
    mine = gone[: len(lines)]
    report.dropped["leaf of a door"] += int(mine.sum())
    report.dropped = +report.dropped
    return [line for line, leaf in zip(lines, mine, strict=True) if not leaf], openings


def cut_openings(
    lines: list[Line], openings: list[Opening], reach_m: float, report: ImportReport
) -> list[Line]:
    """Walls cut where a door lies in them.

    Parameters
    ----------
    lines : list of Line
        Walls as drawn, by one line or two.
    openings : list of Opening
        The doors.
    reach_m : float
        A wall's line lies no farther from its door than this: the thickest wall, metres.
    report : ImportReport
        Told how many walls were cut.
    """
    if not lines or not openings:
        return lines
    ends = np.array([(line.start_m, line.end_m) for line in lines])
    tree = shapely.STRtree(shapely.linestrings(ends))
    taken: dict[int, list[tuple[float, float]]] = {}
    for opening in openings:
        jambs = np.array([opening.start_m, opening.end_m])
        marked = bool(np.linalg.norm(jambs[1] - jambs[0]) < _SHORTEST_M)
        shape = shapely.Point(jambs[0]) if marked else shapely.LineString(jambs)
        for row in tree.query(shape, predicate="dwithin", distance=reach_m):
            start, end = ends[row]
            length = float(np.linalg.norm(end - start))
            if length < _SHORTEST_M:
                continue
            along = (end - start) / length
            at = np.sort((jambs - start) @ along)
            if marked:
                at = at + np.array([-0.5, 0.5]) * _DOOR_M
            else:
                way = (jambs[1] - jambs[0]) / np.linalg.norm(jambs[1] - jambs[0])
                if abs(along[0] * way[1] - along[1] * way[0]) > _PARALLEL:
                    continue
            low, high = max(float(at[0]), 0.0), min(float(at[1]), length)
            if high - low > _SHORTEST_M:
                taken.setdefault(int(row), []).append((low, high))
    made: list[Line] = []
    for row, line in enumerate(lines):
        made += [line] if row not in taken else _without(line, ends[row], taken[row])
    report.collapsed["wall cut by a door"] += len(taken)
    report.collapsed = +report.collapsed
    return made


def _without(line: Line, ends: Array, taken: list[tuple[float, float]]) -> list[Line]:
    """What is left of a line outside of some intervals along it."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    along = (ends[1] - ends[0]) / length
    left, at = [], 0.0
    for low, high in sorted(taken):
        left.append((at, low))
        at = max(at, high)
    left.append((at, length))
    pieces = []
    for low, high in left:
        if high - low >= _SHORTEST_M:
            (x0, y0), (x1, y1) = ends[0] + low * along, ends[0] + high * along
            pieces.append(replace(line, start_m=(float(x0), float(y0)), end_m=(float(x1), float(y1))))
    return pieces
