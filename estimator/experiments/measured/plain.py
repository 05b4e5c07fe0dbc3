"""Plain methods: an extended Kalman filter, and least squares on the latest ranges. They know of no bias."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import rotation_matrix
from estimator.measurements import Epoch, MeasurementSet, Odometry
from estimator.slam.models.motion import Motion

__all__ = ["kalman_track", "least_squares_track"]

Array = NDArray[np.float64]
_LATEST_S = 2.0  # ranges of least squares are no older
_FEWEST = 3  # anchors that tell a place in the plane
_HEADING_STD_RAD = 0.1  # of the body at the start, whose x axis is the estimator's
_STEPS = 8  # of Gauss and Newton


def kalman_track(measurements: MeasurementSet) -> Array:
    """Places (T, 2) of an extended Kalman filter on the shortest path of each anchor.

    Motion, deviations and start are those that the measurements state; nothing else is estimated but the
    direction of the body, where epochs bring odometry: it then takes the place of the motion.

    Parameters
    ----------
    measurements : MeasurementSet
        With known anchors.
    """
    stated = measurements.settings["measurement_model"]
    names = ("acceleration_density", "velocity_memory_s", "velocity_std_m_s", "start_std_m")
    motion = Motion(**{name: stated[name] for name in names if name in stated})
    anchors = measurements.known_anchors_m
    assert anchors is not None
    mean = np.zeros(5)  # place, velocity, direction of the body
    start = max(motion.start_std_m, 0.1) ** 2
    covariance = np.diag([start, start, *[motion.velocity_std_m_s**2] * 2, _HEADING_STD_RAD**2])
    track, before = [], measurements.epochs[0].time_s
    for epoch in measurements.epochs:
        if epoch.time_s > before:
            if epoch.odometry is None:
                driving = motion.driving(epoch.time_s - before)
                move, noise = np.eye(5), np.zeros((5, 5))
                move[:4, :4], noise[:4, :4] = driving.transition, driving.covariance
                mean = move @ mean
            else:
                mean, move, noise = _moved(mean, epoch.odometry)
            covariance = move @ covariance @ move.T + noise
            before = epoch.time_s
        for k, length, std in _shortest(epoch):
            offset = mean[:2] - anchors[k]
            distance = max(float(np.linalg.norm(offset)), 1e-6)
            slope = np.concatenate([offset / distance, np.zeros(3)])
            cross = covariance @ slope
            gain = cross / (slope @ cross + std**2)
            mean = mean + gain * (length - distance)
            covariance = covariance - np.outer(gain, cross)
        track.append(mean[:2])
    return np.array(track)


def _moved(mean: Array, odometry: Odometry) -> tuple[Array, Array, Array]:
    """State (5,) after a step of odometry, its derivatives (5, 5) by that before, and noise (5, 5)."""
    turn = rotation_matrix(float(mean[4]))
    way = turn @ odometry.displacement_m
    move, by_error = np.diag([1.0, 1.0, 0.0, 0.0, 1.0]), np.zeros((5, 3))
    move[0, 4], move[1, 4] = -way[1], way[0]
    by_error[:2, :2], by_error[4, 2] = turn, 1.0
    after = np.array([mean[0] + way[0], mean[1] + way[1], 0.0, 0.0, mean[4] + odometry.turn_rad])
    return after, move, by_error @ odometry.covariance @ by_error.T


def least_squares_track(measurements: MeasurementSet) -> Array:
    """Places (T, 2) where the latest ranges of each anchor fit best; NaN while too few anchors are heard.

    Parameters
    ----------
    measurements : MeasurementSet
        With known anchors.
    """
    anchors = measurements.known_anchors_m
    assert anchors is not None
    latest: dict[int, tuple[float, float]] = {}
    place, track = np.zeros(2), []
    for epoch in measurements.epochs:
        for k, length, _ in _shortest(epoch):
            latest[k] = epoch.time_s, length
        use = [k for k, (when, _) in latest.items() if epoch.time_s - when <= _LATEST_S]
        if len(use) < _FEWEST:
            track.append(np.full(2, np.nan))
            continue
        lengths = np.array([latest[k][1] for k in use])
        for _ in range(_STEPS):
            offset = place - anchors[use]
            distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
            step = np.linalg.lstsq(offset / distance[:, None], lengths - distance, rcond=None)[0]
            place = place + step
            if np.linalg.norm(step) < 1e-4:
                break
        track.append(place)
    return np.array(track)


def _shortest(epoch: Epoch) -> list[tuple[int, float, float]]:
    """Anchor, length and standard deviation of the shortest path of each anchor that was heard."""
    found = []
    for k, paths in enumerate(epoch.paths):
        if len(paths):
            first = int(np.argmin(paths.delay_s))
            found.append((k, float(paths.range_m[first]), float(paths.range_std_m[first])))
    return found
