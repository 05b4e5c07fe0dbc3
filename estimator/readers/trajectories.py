"""Trajectories as text: TUM's ``timestamp tx ty tz qx qy qz qw``, or columns ``time``, ``x``, ``y``."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.readers.text_files import lines_of, number, seconds

__all__ = ["Track", "read_track"]

Array = NDArray[np.float64]
_WHAT = "a trajectory (TUM, or columns time, x, y)"
_COMMA = ","


class Track(NamedTuple):
    """Where something was.

    Parameters
    ----------
    time_s : ndarray, shape (N,)
        Ascending times, seconds.
    position_m : ndarray, shape (N, 2)
        Places, metres.
    """

    time_s: Array
    position_m: Array

    def at(self, time_s: Array) -> Array:
        """Places (T, 2) at some times, on straight lines between those known; NaN beyond the ends."""
        return np.stack(
            [np.interp(time_s, self.time_s, column, np.nan, np.nan) for column in self.position_m.T], axis=1
        )


def read_track(path: Path) -> Track:
    """Read a trajectory.

    Raises
    ------
    FileFormatError
        If it is none, or times do not ascend; names the line and the column.
    """
    lines = [(i, line) for i, line in lines_of(path, _WHAT) if not line.startswith("#")]
    if not lines:
        raise FileFormatError(f"{path}: expected {_WHAT}, got no line")
    cells = [line.split(_COMMA) if _COMMA in line else line.split() for _, line in lines]
    names = [cell.strip().lower() for cell in cells[0]]
    columns = [0, 1, 2]
    first = 0
    if "x" in names and "y" in names:
        time = next((name for name in ("time", "time_s", "timestamp") if name in names), None)
        if time is None:
            raise FileFormatError(
                f"{path}, line {lines[0][0]}: expected a column time, got {', '.join(names)}"[:300]
            )
        columns, first = [names.index(time), names.index("x"), names.index("y")], 1
    rows: list[tuple[float, float, float]] = []
    for (line, _), row in zip(lines[first:], cells[first:], strict=True):
        if len(row) <= max(columns):
            raise FileFormatError(
                f"{path}, line {line}: expected {max(columns) + 1} columns or more, got {len(row)}"
            )
        t = seconds(row[columns[0]], f"{path}, line {line}, column time")
        x, y = (
            number(row[c], f"{path}, line {line}, column {n}") for n, c in zip("xy", columns[1:], strict=True)
        )
        if rows and not t > rows[-1][0]:
            raise FileFormatError(
                f"{path}, line {line}, column time: expected a later one than {rows[-1][0]!r}, got {t!r}"
            )
        rows.append((t, x, y))
    if not rows:
        raise FileFormatError(f"{path}: expected {_WHAT}, got a header alone")
    table = np.array(rows)
    return Track(table[:, 0], table[:, 1:3])
