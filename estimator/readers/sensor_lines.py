"""Ranges as lines of sensors (libRSF): ``range2 time range variance x y module snr``, anchor after anchor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimator.errors import FileFormatError, InputError
from estimator.readers.range_log import RangeLog
from estimator.readers.text_files import lines_of, number

__all__ = ["read_sensor_lines"]

_COLUMNS = ("time", "range", "variance", "x", "y")
_WHAT = "lines of sensors with ranges (range2)"
_MOST_ANCHORS = 1000


def read_sensor_lines(path: Path, names: Sequence[str] = ()) -> RangeLog:
    """Read the ranges of a file of sensors' lines; other sensors are left out.

    Parameters
    ----------
    path : Path
        The file; ``.gz`` is unpacked.
    names : sequence of str
        The modules, in order; by default those of the file, sorted.

    Raises
    ------
    FileFormatError
        If it is none; names the line and the column.
    """
    rows: list[list[float]] = []
    modules: list[str] = []
    places: dict[str, list[float]] = {}
    for line, text in lines_of(path, _WHAT):
        cells = text.split()
        if cells[0] != "range2":
            continue
        if len(cells) < 7:
            raise FileFormatError(f"{path}, line {line}: expected 7 columns or more, got {len(cells)}")
        values = [
            number(c, f"{path}, line {line}, column {n}") for n, c in zip(_COLUMNS, cells[1:], strict=False)
        ]
        module = cells[6]
        if values[2] <= 0.0:
            raise FileFormatError(
                f"{path}, line {line}, column variance: expected a positive number, got {values[2]:g}"
            )
        if places.setdefault(module, values[3:5]) != values[3:5]:
            raise FileFormatError(
                f"{path}, line {line}: expected module {module} at {places[module]}, got {values[3:5]}"
            )
        rows.append(values)
        modules.append(module)
    order = tuple(names) or tuple(sorted(places))
    if not rows or len(order) > _MOST_ANCHORS or not set(order) >= set(places):
        raise FileFormatError(
            f"{path}: expected {_WHAT} of 1 to {_MOST_ANCHORS} modules among those named, "
            f"got those of {len(places)}"
        )
    table = np.array(rows)
    anchor = np.array([order.index(module) for module in modules], dtype=np.int64)
    nowhere = [np.nan, np.nan]
    try:
        return RangeLog(
            table[:, 0],
            anchor,
            table[:, 1],
            order,
            range_std_m=np.sqrt(table[:, 2]),
            anchors_m=np.array([places.get(module, nowhere) for module in order]),
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
