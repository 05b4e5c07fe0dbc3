"""Floors: the least that a part of the work can cost, done by NumPy or SciPy in the same run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from service.bench.rows import cpu_s

__all__ = ["association_s", "joint_update_s", "line_fits_s", "spectrum_s"]

_REPEATS = 7


def joint_update_s(states: int, paths: int) -> float:
    """CPU time of one Kalman prediction and update of a joint Gaussian, seconds."""
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(states, states))
    covariance, jacobian = factor @ factor.T, rng.normal(size=(paths, states))
    transition, noise = np.eye(states), 0.01 * np.eye(states)
    mean, innovation, measured = np.zeros(states), rng.normal(size=paths), np.eye(paths)

    def work() -> NDArray[np.float64]:
        predicted = transition @ covariance @ transition.T + noise
        gain = np.linalg.solve(jacobian @ predicted @ jacobian.T + measured, jacobian @ predicted).T
        return np.asarray(predicted - gain @ jacobian @ predicted + np.outer(mean, gain @ innovation))

    return _each(work, 100)


def association_s(features: int, paths: int, anchors: int) -> float:
    """CPU time of comparing all paths of all anchors with all features once, seconds."""
    rng = np.random.default_rng(1)
    expected, measured = rng.normal(size=(anchors, features, 1)), rng.normal(size=(anchors, 1, paths))
    return _each(lambda: np.exp(-0.5 * (measured - expected) ** 2), 1)


def spectrum_s(data: NDArray[np.complex128], oversampling: int = 4) -> float:
    """CPU time of one discrete Fourier transform over all of its axes but the first, seconds."""
    axes = tuple(range(1, data.ndim))
    sizes = [scipy.fft.next_fast_len(oversampling * data.shape[axis]) for axis in axes]
    return _each(lambda: np.asarray(scipy.fft.ifftn(data, sizes, axes)), 1)


def line_fits_s(points: NDArray[np.float64]) -> float:
    """CPU time of total least squares through points (fits, n, 2), seconds."""

    def work() -> NDArray[np.float64]:
        centred = points - points.mean(axis=1, keepdims=True)
        return np.linalg.eigh(centred.swapaxes(1, 2) @ centred)[1]

    return _each(work, 1)


def _each(work: Callable[[], object], count: int) -> float:
    return cpu_s(lambda: [work() for _ in range(count)], _REPEATS) / count
