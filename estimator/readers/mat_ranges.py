"""Ranges in MATLAB files (version 5 to 7.2), as range-only SLAM data sets have them.

``TD`` holds rows of time, a number of no meaning, beacon and range; ``TL`` rows of beacon, x and y.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError, InputError
from estimator.readers.mat_file import read_matrices
from estimator.readers.range_log import RangeLog

__all__ = ["read_mat", "read_mat_track"]

Array = NDArray[np.float64]


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
    data = read_matrices(path, ("TD", "TL"))
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
    track = _matrix(path, read_matrices(path, ("GT",)), "GT", 4)
    return track[:, 0], track[:, 1:3]


def _matrix(path: Path, data: dict[str, Array], name: str, columns: int) -> Array:
    if name not in data:
        raise FileFormatError(
            f"{path}: expected {name} as rows of {columns} real numbers, it is missing or none"
        )
    matrix = data[name]
    if matrix.shape[1] != columns or len(matrix) == 0:
        raise FileFormatError(
            f"{path}: expected {name} as rows of {columns} numbers, got shape {matrix.shape}"
        )
    if not np.isfinite(matrix).all():
        row = int(np.flatnonzero(~np.isfinite(matrix).all(axis=1))[0])
        raise FileFormatError(f"{path}: expected finite numbers in {name}, got others in row {row + 1}")
    return matrix
