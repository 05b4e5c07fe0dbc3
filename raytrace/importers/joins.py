"""Ends of walls are led to the walls they run into.

After double lines have become centre lines, a wall ends half a thickness before the
centre line of its neighbour, and drawings have gaps of millimetres. Each end moves
along its own wall to the nearest crossing with another, if that lies no farther than
half the drawn thicknesses of the two explain (divided by the sine of their angle), or
than the snap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from raytrace.importers.drawing import ImportReport, Line

__all__ = ["join_ends"]

Array = NDArray[np.float64]

_SNAP_M = 0.01
_ON_M = 1e-6
_FLATTEST_SINE = 0.2


def join_ends(lines: list[Line], report: ImportReport) -> list[Line]:
    """Move ends to the walls they run into.

    Parameters
    ----------
    lines : list of Line
        Walls as single surfaces; ``drawn_m`` is what each was collapsed from.
    report : ImportReport
        Told how many ends were moved.

    Returns
    -------
    list of Line
        In the same order; walls that shrink to nothing are left out.
    """
    if not lines:
        return []
    start = np.array([line.start_m for line in lines])
    vector = np.array([line.end_m for line in lines]) - start
    length = np.linalg.norm(vector, axis=1)
    unit = vector / length[:, None]
    drawn = np.array([line.drawn_m for line in lines])
    joined = []
    for row, (line, others) in enumerate(zip(lines, _neighbours(start, vector, drawn), strict=True)):
        sine = unit[row, 0] * unit[others, 1] - unit[row, 1] * unit[others, 0]
        offset = start[others] - start[row]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (offset[:, 0] * unit[others, 1] - offset[:, 1] * unit[others, 0]) / sine
            across = (offset[:, 0] * unit[row, 1] - offset[:, 1] * unit[row, 0]) / sine
        steep = np.abs(sine) >= _FLATTEST_SINE
        reach = 0.5 * (drawn[others] + drawn[row]) / np.maximum(np.abs(sine), _FLATTEST_SINE) + _SNAP_M
        meets = steep & (across >= -reach) & (across <= length[others] + reach) & (others != row)
        ends = []
        for at in (0.0, length[row]):
            gap = np.where(meets, np.abs(along - at), np.inf)
            best = int(np.argmin(np.where(gap <= reach, gap, np.inf)))
            moves = gap[best] <= reach[best] and gap[best] > _ON_M
            ends.append(float(along[best]) if moves else float(at))
            report.collapsed["end of a wall led to its neighbour"] += int(moves)
        if ends[1] - ends[0] > _SNAP_M:
            points = [start[row] + at * unit[row] for at in ends]
            (x0, y0), (x1, y1) = ((round(float(x), 6), round(float(y), 6)) for x, y in points)
            joined.append(replace(line, start_m=(x0, y0), end_m=(x1, y1)))
        else:
            report.dropped["line that lay within another wall"] += 1
    report.collapsed = +report.collapsed
    return joined


def _neighbours(start: Array, vector: Array, drawn: Array) -> list[NDArray[np.int64]]:
    """For each line those, in ascending order, that may meet it beyond its ends; itself is among them.

    Where they meet is within reach of its end and of theirs, so that these are within twice the reach.
    """
    lines = shapely.linestrings(np.stack([start, start + vector], axis=1))
    ends = shapely.points(np.stack([start, start + vector], axis=1).reshape(-1, 2))
    reach = 0.5 * (drawn + drawn.max()) / _FLATTEST_SINE + _SNAP_M
    end, other = shapely.STRtree(lines).query(ends, predicate="dwithin", distance=np.repeat(2.0 * reach, 2))
    pairs = np.unique((end // 2) * len(lines) + other)
    first = np.searchsorted(pairs, np.arange(1, len(lines)) * len(lines))
    return np.split(pairs % len(lines), first)
