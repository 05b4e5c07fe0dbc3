"""Ranges in MATLAB files (version 5 to 7.2), as range-only SLAM data sets have them.

``TD`` holds rows of time, a number of no meaning, beacon and range; ``TL`` rows of beacon, x and y.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError, InputError
from estimator.readers.range_log import RangeLog

__all__ = ["read_mat", "read_mat_track"]

Array = NDArray[np.float64]
_LARGEST = 1 << 28  # bytes
_BROKEN = (  # what the reader of MATLAB files raises of damaged ones
    *(ValueError, TypeError, OSError, EOFError, LookupError, NotImplementedError, MemoryError),
    *(OverflowError, UnicodeError, AttributeError, AssertionError, zlib.error),
)


def read_mat(path: Path, names: Sequence[str] = ()) -> RangeLog:
    """Read the ranges of a MATLAB file.

    Parameters
    ----------
    path : Path
        The file.
    names : sequence of str
        The beacons' numbers, in order; by default those of ``TL``, ascending.

    Raises
    ------
    FileFormatError
        If it is no such file, or ranges and beacons do not fit.
    """
    data = _variables(path, ("TD", "TL"))
    ranges, beacons = _matrix(path, data, "TD", 4), _matrix(path, data, "TL", 3)
    number = beacons[:, 0]
    if len(np.unique(number)) < len(number):
        raise FileFormatError(f"{path}: expected beacons in TL whose numbers differ, got {number.tolist()}")
    beacons = beacons[np.argsort(number)]
    order = tuple(f"{value:g}" for value in beacons[:, 0])
    if names:
        strange = [name for name in names if name not in order]
        if strange:
            raise FileFormatError(f"{path}: expected beacons among {', '.join(order)}, got {strange[0]!r}")
        beacons, order = beacons[[order.index(name) for name in names]], tuple(names)
    place = {value: k for k, value in enumerate(beacons[:, 0].tolist())}
    asked = ranges[:, 2].tolist()
    for row, value in enumerate(asked):
        if value not in place:
            raise FileFormatError(f"{path}: expected in TD beacons of TL, got {value:g} in row {row + 1}")
    anchor = np.array([place[value] for value in asked], dtype=np.int64)
    try:
        return RangeLog(ranges[:, 0], anchor, ranges[:, 3], order, anchors_m=beacons[:, 1:3])
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def read_mat_track(path: Path) -> tuple[Array, Array]:
    """The true track of a MATLAB file: times (N,) and places (N, 2) of ``GT``, rows of time, x, y, heading.

    Raises
    ------
    FileFormatError
        If it is no such file.
    """
    track = _matrix(path, _variables(path, ("GT",)), "GT", 4)
    return track[:, 0], track[:, 1:3]


def _variables(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    from scipy.io import loadmat

    path = Path(path)
    wanted = f"a MATLAB file with {', '.join(names)}"
    if not path.is_file():
        raise FileFormatError(f"{path}: expected {wanted}, found nothing there")
    if path.stat().st_size > _LARGEST:
        raise FileFormatError(f"{path}: expected {wanted} of at most {_LARGEST >> 20} MiB")
    try:
        data = loadmat(path, variable_names=list(names), appendmat=False)
    except _BROKEN as error:
        raise FileFormatError(f"{path}: expected {wanted}, could not read it: {error}"[:400]) from error
    missing = [name for name in names if name not in data]
    if missing:
        raise FileFormatError(f"{path}: expected {wanted}; {', '.join(missing)} is missing")
    return dict(data)


def _matrix(path: Path, data: dict[str, Any], name: str, columns: int) -> Array:
    value = data[name]
    fits = isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiu"
    if not fits or value.shape[1] != columns or len(value) == 0:
        got = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise FileFormatError(f"{path}: expected {name} as rows of {columns} numbers, got {got}")
    matrix: Array = value.astype(np.float64)
    if not np.isfinite(matrix).all():
        row = int(np.flatnonzero(~np.isfinite(matrix).all(axis=1))[0])
        raise FileFormatError(f"{path}: expected finite numbers in {name}, got others in row {row + 1}")
    return matrix
