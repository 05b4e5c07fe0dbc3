"""Odometry of a robot's wheels, and the heading that its first ranges give it.

The set tells speeds of two wheels and of the side, and half the track of the wheels. What the description
calls the right wheel is the left one: the other way round the way does not close.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.experiments.measured.plain import least_squares_track
from estimator.geometry import rotation_matrix
from estimator.measurements import MeasurementSet
from estimator.odometry import Odometry
from estimator.readers.text_files import lines_of, number

__all__ = ["with_wheels"]

Array = NDArray[np.float64]
_COLUMNS = 9
_WAY_M = 2.0  # on which the heading is found


def with_wheels(measurements: MeasurementSet, path: Path) -> tuple[MeasurementSet, float] | None:
    """The measurements with odometry in the robot's axes at the start, and its heading there; None without.

    Parameters
    ----------
    measurements : MeasurementSet
        Ranges with known anchors; its epochs have the time stamps of the odometry.
    path : Path
        Lines of sensors with ``odom2diff``.

    Raises
    ------
    FileFormatError
        If a line is damaged.
    """
    rows = []
    for line, text in lines_of(path, "lines of sensors with odometry (odom2diff)"):
        cells = text.split()
        if cells[0] == "odom2diff":
            if len(cells) < _COLUMNS:
                raise FileFormatError(f"{path}, line {line}: expected {_COLUMNS} columns, got {len(cells)}")
            rows.append([number(cell, f"{path}, line {line}") for cell in cells[1:_COLUMNS]])
    if not rows:
        return None
    table = np.array(rows)
    time = np.array([epoch.time_s for epoch in measurements.epochs])
    stamp = table[:, 0] - float(measurements.settings["first_time_s"])
    wheel = table[np.clip(np.searchsorted(stamp, time[:-1] - 1e-6), 0, len(table) - 1)]
    step, track_m = np.diff(time), 2.0 * wheel[:, 4]
    turn = (wheel[:, 2] - wheel[:, 1]) / track_m * step
    ahead, side = 0.5 * (wheel[:, 1] + wheel[:, 2]) * step, wheel[:, 3] * step
    left, right, across = (wheel[:, c] * step**2 for c in (5, 6, 7))
    moved = [
        Odometry(
            rotation_matrix(0.5 * turn[i]) @ [ahead[i], side[i]],
            turn[i],
            np.array(
                [
                    [0.25 * (left[i] + right[i]), 0.0, 0.5 * (right[i] - left[i]) / track_m[i]],
                    [0.0, across[i], 0.0],
                    [0.5 * (right[i] - left[i]) / track_m[i], 0.0, (left[i] + right[i]) / track_m[i] ** 2],
                ]
            ),
        )
        for i in range(len(step))
    ]
    heading = _heading(measurements, moved)
    known = measurements.known_anchors_m
    assert known is not None
    epochs = tuple(
        replace(epoch, odometry=one) for epoch, one in zip(measurements.epochs, [None, *moved], strict=True)
    )
    turned = known @ rotation_matrix(-heading).T
    return replace(measurements, epochs=epochs, known_anchors_m=turned), heading


def _heading(measurements: MeasurementSet, moved: list[Odometry]) -> float:
    """Direction of the robot at the start that brings its first way onto the places of least squares."""
    place, direction, way = np.zeros(2), 0.0, [np.zeros(2)]
    gone = 0.0
    for one in moved:
        place = place + rotation_matrix(direction) @ one.displacement_m
        direction += one.turn_rad
        gone += float(np.linalg.norm(one.displacement_m))
        way.append(place)
        if gone > _WAY_M:
            break
    own = np.array(way)
    seen = least_squares_track(measurements)[: len(own)]
    good = np.isfinite(seen).all(axis=1)
    a, b = own[good] - own[good].mean(axis=0), seen[good] - seen[good].mean(axis=0)
    return float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
