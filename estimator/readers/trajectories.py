"""Trajectories as text: TUM's ``timestamp tx ty tz qx qy qz qw``, or columns ``time``, ``x``, ``y``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.readers.text_files import lines_of, number, seconds

__all__ = ["Track", "read_cells", "read_track", "timed_rows"]

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
    lines, cells = read_cells(path, _WHAT)
    if not lines:
        raise FileFormatError(f"{path}: expected {_WHAT}, got no line")
    names = [cell.strip().lower() for cell in cells[0]]
    columns = [0, 1, 2]
    first = 0
    if "x" in names and "y" in names:
        time = next((name for name in ("time", "time_s", "timestamp") if name in names), None)
        if time is None:
            raise FileFormatError(
                f"{path}, line {lines[0]}: expected a column time, got {', '.join(names)}"[:300]
            )
        columns, first = [names.index(time), names.index("x"), names.index("y")], 1
    where = [f"{path}, line {line}" for line in lines[first:]]
    table = np.array(timed_rows(where, cells[first:], columns, ["x", "y"]))
    if not len(table):
        raise FileFormatError(f"{path}: expected {_WHAT}, got a header alone")
    return Track(table[:, 0], table[:, 1:3])


def read_cells(path: Path, what: str) -> tuple[list[int], list[list[str]]]:
    """Numbers of the lines of a table that are no comments, and their cells: after commas, or else blanks.

    Raises
    ------
    FileFormatError
        If the file cannot be read as text.
    """
    lines = [(i, line) for i, line in lines_of(path, what) if not line.startswith("#")]
    cells = [line.split(_COMMA) if _COMMA in line else line.split() for _, line in lines]
    return [i for i, _ in lines], cells


def timed_rows(
    where: Sequence[str], cells: Sequence[Sequence[str]], columns: Sequence[int], labels: Sequence[str]
) -> list[list[float]]:
    """Times in seconds, ascending, and numbers beside them.

    Parameters
    ----------
    where : sequence of str
        Where each row stands, for errors.
    cells : sequence of sequences of str
        The rows.
    columns : sequence of int
        The column of the time, then those of the numbers,
    labels : sequence of str
        and the names of these.

    Raises
    ------
    FileFormatError
        If a row is short, a cell no number, or times do not ascend; names the column.
    """
    rows: list[list[float]] = []
    for place, row in zip(where, cells, strict=True):
        if len(row) <= max(columns):
            raise FileFormatError(f"{place}: expected {max(columns) + 1} columns or more, got {len(row)}")
        time = seconds(row[columns[0]], f"{place}, column time")
        named = zip(columns[1:], labels, strict=True)
        values = [number(row[column], f"{place}, column {label}") for column, label in named]
        if rows and not time > rows[-1][0]:
            raise FileFormatError(
                f"{place}, column time: expected a later one than {rows[-1][0]!r}, got {time!r}"
            )
        rows.append([time, *values])
    return rows
