"""Near-constant-velocity motion of the agent (equation (39))."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.layout import Layout

__all__ = ["predict_motion", "process_noise", "transition"]

Array = NDArray[np.float64]


def transition(step_s: float) -> Array:
    """Matrix A of (39) for (x, y, vx, vy)."""
    matrix = np.eye(4)
    matrix[0, 2] = matrix[1, 3] = step_s
    return matrix


def process_noise(step_s: float, acceleration_variance: float) -> Array:
    """Covariance (4, 4) of the driving noise: an acceleration held over the step."""
    gain = np.array([[0.5 * step_s**2, 0.0], [0.0, 0.5 * step_s**2], [step_s, 0.0], [0.0, step_s]])
    return np.asarray(acceleration_variance * gain @ gain.T)


def predict_motion(
    mean: Array, covariance: Array, step_s: float, acceleration_variance: float
) -> tuple[Array, Array]:
    """Means (R, n) and covariances (R, n, n) one step later; only the agent moves."""
    place, speed, agent = slice(0, 2), slice(2, 4), Layout.AGENT
    mean, covariance = mean.copy(), covariance.copy()
    mean[:, place] += step_s * mean[:, speed]
    covariance[:, place] += step_s * covariance[:, speed]
    covariance[:, :, place] += step_s * covariance[:, :, speed]
    moved = covariance[:, agent, agent] + process_noise(step_s, acceleration_variance)
    covariance[:, agent, agent] = 0.5 * (moved + moved.transpose(0, 2, 1))
    return mean, covariance
