"""Ranges as text with named columns (CSV): a row a range, or a row an epoch with a column an anchor.

``time``, ``anchor`` and ``range_m`` (or ``delay_s``, ``delay_ns``) make a row a range; ``range_std_m``,
``gain_db``, ``azimuth_rad`` or ``azimuth_deg`` with ``azimuth_std_rad`` or ``azimuth_std_deg``, and ``asked``
(0 or 1) may be added. Without a column ``anchor``, every column but ``time`` is an anchor's ranges in metres.
An empty range says that the anchor was asked and not heard.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError, InputError
from estimator.readers.range_log import RangeLog
from estimator.readers.text_files import lines_of, number, seconds
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["read_anchors", "read_csv"]

Array = NDArray[np.float64]
_WHAT = "ranges as text with named columns"
_TIME = ("time", "time_s", "timestamp")
_SCALES = {  # of each column, the quantity and what makes SI units of it
    "range_m": ("range_m", 1.0),
    "delay_s": ("range_m", SPEED_OF_LIGHT_M_S),
    "delay_ns": ("range_m", 1e-9 * SPEED_OF_LIGHT_M_S),
    "range_std_m": ("range_std_m", 1.0),
    "delay_std_s": ("range_std_m", SPEED_OF_LIGHT_M_S),
    "gain_db": ("gain_db", 1.0),
    "azimuth_rad": ("azimuth_rad", 1.0),
    "azimuth_deg": ("azimuth_rad", np.pi / 180.0),
    "azimuth_std_rad": ("azimuth_std_rad", 1.0),
    "azimuth_std_deg": ("azimuth_std_rad", np.pi / 180.0),
}
_MOST_ANCHORS = 1000


def read_csv(path: Path, names: Sequence[str] = ()) -> RangeLog:
    """Read a log of ranges.

    Parameters
    ----------
    path : Path
        The file; ``.gz`` is unpacked.
    names : sequence of str
        The anchors, in order; by default those of the file in the order in which they come.

    Raises
    ------
    FileFormatError
        If it is none; names the line and the column.
    """
    header, rows = _table(path)
    try:
        if "anchor" in header:
            return _long(path, header, rows, names)
        return _wide(path, header, rows, names)
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def read_anchors(path: Path) -> tuple[tuple[str, ...], Array]:
    """Names and places (K, 2) of anchors: columns ``anchor``, ``x``, ``y``.

    Raises
    ------
    FileFormatError
        If it is no such file; names the line and the column.
    """
    header, rows = _table(path)
    lacking = [name for name in ("anchor", "x", "y") if name not in header]
    if lacking:
        raise FileFormatError(f"{path}: expected the columns anchor, x, y; {', '.join(lacking)} is missing")
    names, places = [], []
    for line, cells in rows:
        names.append(cells[header.index("anchor")])
        places.append(
            [number(cells[header.index(c)], f"{path}, line {line}, column {c}") for c in ("x", "y")]
        )
    if not names or len(set(names)) < len(names):
        raise FileFormatError(
            f"{path}: expected anchors with names that differ, got {', '.join(names) or 'none'}"
        )
    return tuple(names), np.array(places)


def _table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Names of the columns, and the rows with the numbers of their lines."""
    lines = [(i, line) for i, line in lines_of(path, _WHAT) if not line.startswith("#")]
    if len(lines) < 2:
        raise FileFormatError(f"{path}: expected {_WHAT}, a header and rows, got {len(lines)} lines")
    delimiter = max(",;\t", key=lines[0][1].count)
    try:
        parsed = list(csv.reader((line for _, line in lines), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise FileFormatError(f"{path}: expected {_WHAT}, could not read it: {error}") from error
    if len(parsed) != len(lines):
        raise FileFormatError(f"{path}: expected a row on every line, got a quoted line break")
    header = [name.strip() for name in parsed[0]]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice or "" in header:
        raise FileFormatError(
            f"{path}, line {lines[0][0]}: expected columns with names that differ, got {header}"[:300]
        )
    for (line, _), cells in zip(lines, parsed, strict=True):
        if len(cells) != len(header):
            raise FileFormatError(f"{path}, line {line}: expected {len(header)} columns, got {len(cells)}")
    return header, [
        (line, [c.strip() for c in cells]) for (line, _), cells in zip(lines[1:], parsed[1:], strict=True)
    ]


def _time_column(path: Path, header: list[str]) -> int:
    for name in _TIME:
        if name in header:
            return header.index(name)
    raise FileFormatError(f"{path}: expected a column {' or '.join(_TIME)}, got {', '.join(header)}"[:300])


def _long(path: Path, header: list[str], rows: list[tuple[int, list[str]]], names: Sequence[str]) -> RangeLog:
    """A row a range."""
    at = _time_column(path, header)
    own = [i for i in range(len(header)) if i != at]
    known = {*_SCALES, "anchor", "asked"}
    strange = [header[i] for i in own if header[i] not in known]
    if strange:
        raise FileFormatError(
            f"{path}: expected columns among {', '.join(sorted(known))}, got {strange[0]!r}"
        )
    quantities = [_SCALES[header[i]][0] for i in own if header[i] in _SCALES]
    if "range_m" not in quantities or len(set(quantities)) < len(quantities):
        raise FileFormatError(f"{path}: expected one of range_m, delay_s, delay_ns, and each quantity once")
    columns = {name: np.full(len(rows), np.nan) for name in quantities}
    time, anchor, use = np.empty(len(rows)), [], np.ones(len(rows), dtype=bool)
    for n, (line, cells) in enumerate(rows):
        time[n] = seconds(cells[at], f"{path}, line {line}, column {header[at]}")
        anchor.append(cells[header.index("anchor")])
        for i in own:
            where = f"{path}, line {line}, column {header[i]}"
            if header[i] == "asked":
                use[n] = _flag(cells[i], where)
            elif header[i] in _SCALES:
                quantity, scale = _SCALES[header[i]]
                columns[quantity][n] = scale * number(cells[i], where, empty=True)
        if not use[n] and np.isfinite(columns["range_m"][n]):
            raise FileFormatError(f"{path}, line {line}: expected no range of an anchor that was not asked")
    order = tuple(names) or tuple(dict.fromkeys(anchor))
    place = _places(path, order, anchor, [line for line, _ in rows])
    return RangeLog(
        time[use], place[use], names=order, **{name: column[use] for name, column in columns.items()}
    )


def _wide(path: Path, header: list[str], rows: list[tuple[int, list[str]]], names: Sequence[str]) -> RangeLog:
    """A row an epoch, a column an anchor."""
    at = _time_column(path, header)
    order = tuple(names) or tuple(name for i, name in enumerate(header) if i != at)
    if not order or len(order) > _MOST_ANCHORS:
        raise FileFormatError(f"{path}: expected columns of 1 to {_MOST_ANCHORS} anchors, got {len(order)}")
    _places(path, tuple(header), list(order), [1] * len(order))
    column = [header.index(name) for name in order]
    time = np.array([seconds(cells[at], f"{path}, line {line}, column {header[at]}") for line, cells in rows])
    length = np.array(
        [
            [number(cells[c], f"{path}, line {line}, column {header[c]}", empty=True) for c in column]
            for line, cells in rows
        ]
    )
    count = len(order)
    return RangeLog(np.repeat(time, count), np.tile(np.arange(count), len(rows)), length.ravel(), order)


def _places(path: Path, order: tuple[str, ...], wanted: list[str], line: list[int]) -> NDArray[np.int64]:
    """Where each of the wanted names stands in an order."""
    if len(order) > _MOST_ANCHORS:
        raise FileFormatError(f"{path}: expected at most {_MOST_ANCHORS} anchors, got {len(order)}")
    place = {name: k for k, name in enumerate(order)}
    for name, i in zip(wanted, line, strict=True):
        if name not in place:
            known = ", ".join(order)[:200]
            raise FileFormatError(f"{path}, line {i}: expected anchors among {known}, got {name[:40]!r}")
    return np.array([place[name] for name in wanted], dtype=np.int64)


def _flag(text: str, where: str) -> bool:
    if text.lower() not in ("0", "1", "true", "false", ""):
        raise FileFormatError(f"{where}: expected 0 or 1, got {text[:40]!r}")
    return text.lower() in ("1", "true", "")
