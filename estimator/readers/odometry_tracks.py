"""Odometry from trajectories: what a robot's or a camera's own track says of each step between epochs.

A trajectory of odometry (TUM's ``timestamp tx ty tz qx qy qz qw``, z up and x ahead, or columns ``time``,
``x``, ``y``, ``heading_deg``) has a frame of its own and drifts; what it tells are steps. Their errors are
taken to be independent from step to step: their variances grow with the way and with time, whatever the rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError, FileFormatError, InputError
from estimator.geometry import rotation_matrix
from estimator.measurements import MeasurementSet
from estimator.odometry import Odometry
from estimator.readers.trajectories import read_cells, timed_rows

__all__ = ["OdometryNoise", "Poses", "find_heading", "read_poses", "with_odometry"]

Array = NDArray[np.float64]
_WHAT = "odometry (TUM, or columns time, x, y, heading_deg)"
_UNIT = 1e-2  # how far the norm of a quaternion may be off 1: what few digits leave


class Poses(NamedTuple):
    """Places and directions of a body, in any frame.

    Parameters
    ----------
    time_s : ndarray, shape (N,)
        Ascending times, seconds.
    position_m : ndarray, shape (N, 2)
        Places, metres.
    heading_rad : ndarray, shape (N,)
        Direction of the body, counter-clockwise from the x axis, without jumps by whole turns.
    """

    time_s: Array
    position_m: Array
    heading_rad: Array


@dataclass(frozen=True)
class OdometryNoise:
    """What odometry is believed: wheels and visual odometry of small robots.

    Parameters
    ----------
    way_std_m, turn_std_rad : float
        Standard deviations of way (per axis) and direction after a metre, metres and radians (1 degree).
    still_std_m, still_turn_std_rad : float
        What is added in a second, also at rest.
    """

    way_std_m: float = 0.05
    turn_std_rad: float = 0.0175
    still_std_m: float = 0.005
    still_turn_std_rad: float = 0.002

    def __post_init__(self) -> None:
        for name in ("way_std_m", "turn_std_rad", "still_std_m", "still_turn_std_rad"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")


def read_poses(path: Path) -> Poses:
    """Read a trajectory with directions.

    Raises
    ------
    FileFormatError
        If it is none, or times do not ascend; names the line and the column.
    """
    lines, cells = read_cells(path, _WHAT)
    names = [cell.strip().lower() for cell in cells[0]] if cells else []
    columns = ["time", "x", "y", "heading_deg"]
    tum = "x" not in names
    if not tum and not set(columns) <= set(names):
        raise FileFormatError(
            f"{path}, line {lines[0]}: expected columns {', '.join(columns)}, got {', '.join(names)}"[:300]
        )
    place = [0, 1, 2, 4, 5, 6, 7] if tum else [names.index(name) for name in columns]
    labels = ["tx", "ty", "qx", "qy", "qz", "qw"] if tum else columns[1:]
    where = [f"{path}, line {line}" for line in lines[not tum :]]
    rows = timed_rows(where, cells[not tum :], place, labels)
    turn = [_yaw(row[3:], line) if tum else np.radians(row[3]) for row, line in zip(rows, where, strict=True)]
    if len(rows) < 2:
        raise FileFormatError(f"{path}: expected {_WHAT} of two lines or more, got {len(rows)}")
    table = np.array(rows)
    return Poses(table[:, 0], table[:, 1:3], np.unwrap(turn))


def _yaw(quaternion: list[float], where: str) -> float:
    """Direction of the x axis that a quaternion (x, y, z, w) turns, seen from above."""
    x, y, z, w = quaternion
    if abs(np.sqrt(x * x + y * y + z * z + w * w) - 1.0) > _UNIT:
        raise FileFormatError(f"{where}: expected a unit quaternion qx qy qz qw, got {x:g} {y:g} {z:g} {w:g}")
    return float(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def with_odometry(
    measurements: MeasurementSet,
    poses: Poses,
    heading_rad: float | None = None,
    noise: OdometryNoise | None = None,
) -> MeasurementSet:
    """Measurements with the odometry of a trajectory between their epochs.

    Parameters
    ----------
    measurements : MeasurementSet
        With known anchors and without directions, as logs of ranges make them.
    poses : Poses
        The odometry; its clock is that of the log. Epochs beyond its ends have none.
    heading_rad : float, optional
        Direction of the body at the first epoch, in the anchors' frame; by default the one that brings its
        first way onto the ranges.
    noise : OdometryNoise, optional
        What is believed of it.

    Raises
    ------
    InputError
        If the trajectory does not reach the first epochs, directions are measured, or the way does not tell
        the heading.
    """
    noise = noise or OdometryNoise()
    if any(paths.azimuth_rad is not None for epoch in measurements.epochs for paths in epoch.paths):
        raise InputError("odometry: expected ranges beside it, got directions too")
    time = np.array([epoch.time_s for epoch in measurements.epochs])
    time = time + float(measurements.settings.get("first_time_s", 0.0))
    if not (poses.time_s[0] <= time[0] and len(time) > 1 and time[1] <= poses.time_s[-1]):
        raise InputError(
            f"odometry: expected times about those of the ranges, {time[0]:.3f} to {time[-1]:.3f} s, "
            f"got {poses.time_s[0]:.3f} to {poses.time_s[-1]:.3f} s"
        )
    x, y, heading = (
        np.interp(time, poses.time_s, column, right=np.nan)
        for column in (*poses.position_m.T, poses.heading_rad)
    )
    place = np.stack([x, y], axis=1)
    if heading_rad is None:
        own = (place - place[0]) @ rotation_matrix(-heading[0]).T
        heading_rad = find_heading(measurements, own, noise)
    moved: list[Odometry | None] = [None]
    for i in range(1, len(time)):
        if not np.isfinite(heading[i]):
            moved.append(None)
            continue
        # in axes that are those of the anchors at the first epoch, and turn with the body
        step = rotation_matrix(heading_rad - heading[i - 1]) @ (place[i] - place[i - 1])
        way, since = float(np.linalg.norm(step)), float(time[i] - time[i - 1])
        across = noise.way_std_m**2 * way + noise.still_std_m**2 * since
        turn = noise.turn_std_rad**2 * way + noise.still_turn_std_rad**2 * since
        moved.append(Odometry(step, heading[i] - heading[i - 1], np.diag([across, across, turn])))
    epochs = tuple(
        replace(epoch, odometry=one) for epoch, one in zip(measurements.epochs, moved, strict=True)
    )
    return replace(measurements, epochs=epochs)


def find_heading(
    measurements: MeasurementSet,
    way_m: Array,
    noise: OdometryNoise,
    longest_m: float = 10.0,
    shortest_m: float = 2.0,
) -> float:
    """Direction of the body at the first epoch that brings its first way onto the ranges.

    Ranges tell it by how they change: a bias of each anchor is fitted.

    Parameters
    ----------
    measurements : MeasurementSet
        Ranges of T epochs with known anchors, the start at the origin.
    way_m : ndarray, shape (T, 2)
        Places of the body in its axes at the first epoch; NaN where they are not known.
    noise : OdometryNoise
        How the way drifts.
    longest_m, shortest_m : float
        The way that is used, before it has drifted, and the least that tells a direction, metres.

    Raises
    ------
    InputError
        If the way is too short, or more than one direction fits.
    """
    gone = np.cumsum(np.append(0.0, np.linalg.norm(np.diff(way_m, axis=0), axis=1)))
    used = np.flatnonzero(gone <= longest_m)
    far = float(np.max(np.linalg.norm(way_m[used], axis=1)))
    if far < shortest_m or measurements.known_anchors_m is None:
        raise InputError(
            f"heading: expected a way of {shortest_m:g} m among known anchors, got {far:.2f} m; say it"
        )
    epoch, anchor, length, variance = [], [], [], []
    for i in used.tolist():
        for k, paths in enumerate(measurements.epochs[i].paths):
            if len(paths):
                epoch.append(i)
                anchor.append(k)
                length.append(float(paths.range_m[0]))
                drift = noise.way_std_m**2 * gone[i] + (noise.turn_std_rad * gone[i]) ** 2 * gone[i]
                variance.append(float(paths.range_std_m[0]) ** 2 + drift)
    who, told, spread = np.array(anchor), np.array(length), np.array(variance)
    tried = np.radians(np.arange(360.0))
    cost = np.empty(len(tried))
    for n, angle in enumerate(tried):
        places = way_m[epoch] @ rotation_matrix(angle).T
        left = told - np.linalg.norm(places - measurements.known_anchors_m[who], axis=1)
        for k in np.unique(who):
            left[who == k] -= np.median(left[who == k])
        cost[n] = np.minimum(left**2 / spread, 9.0).sum()
    best = int(np.argmin(cost))
    apart = np.abs((np.arange(360) - best + 180) % 360 - 180)
    if np.any((apart > 30) & (cost < cost[best] + 9.0)):
        other = int(np.argmin(np.where(apart > 30, cost, np.inf)))
        raise InputError(
            f"heading: expected one direction that fits the first way, got {best} and {other} degrees; say it"
        )
    return float(tried[best])
