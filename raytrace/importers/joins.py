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

from raytrace.importers.drawing import ImportReport, Line

__all__ = ["join_ends"]

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
    for row, line in enumerate(lines):
        sine = unit[row, 0] * unit[:, 1] - unit[row, 1] * unit[:, 0]
        offset = start - start[row]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (offset[:, 0] * unit[:, 1] - offset[:, 1] * unit[:, 0]) / sine
            across = (offset[:, 0] * unit[row, 1] - offset[:, 1] * unit[row, 0]) / sine
        steep = np.abs(sine) >= _FLATTEST_SINE
        reach = 0.5 * (drawn + drawn[row]) / np.maximum(np.abs(sine), _FLATTEST_SINE) + _SNAP_M
        meets = steep & (across >= -reach) & (across <= length + reach)
        meets[row] = False
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
