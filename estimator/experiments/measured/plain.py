"""Plain methods: an extended Kalman filter, and least squares on the latest ranges. They know of no bias."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch, MeasurementSet
from estimator.slam.models.motion import Motion

__all__ = ["kalman_track", "least_squares_track"]

Array = NDArray[np.float64]
_LATEST_S = 2.0  # ranges of least squares are no older
_FEWEST = 3  # anchors that tell a place in the plane
_STEPS = 8  # of Gauss and Newton


def kalman_track(measurements: MeasurementSet) -> Array:
    """Places (T, 2) of an extended Kalman filter on the shortest path of each anchor.

    Motion, deviations and start are those that the measurements state; nothing else is estimated.

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
    mean = np.zeros(4)
    covariance = np.diag([max(motion.start_std_m, 0.1) ** 2] * 2 + [motion.velocity_std_m_s**2] * 2)
    track, before = [], measurements.epochs[0].time_s
    for epoch in measurements.epochs:
        if epoch.time_s > before:
            driving = motion.driving(epoch.time_s - before)
            mean = driving.transition @ mean
            covariance = driving.transition @ covariance @ driving.transition.T + driving.covariance
            before = epoch.time_s
        for k, length, std in _shortest(epoch):
            offset = mean[:2] - anchors[k]
            distance = max(float(np.linalg.norm(offset)), 1e-6)
            slope = np.concatenate([offset / distance, [0.0, 0.0]])
            cross = covariance @ slope
            gain = cross / (slope @ cross + std**2)
            mean = mean + gain * (length - distance)
            covariance = covariance - np.outer(gain, cross)
        track.append(mean[:2])
    return np.array(track)


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
