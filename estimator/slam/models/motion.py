"""Near-constant-velocity motion of the agent (equation (39))."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.settings import Settings, not_negative, positive

__all__ = ["Motion", "predict_motion", "process_noise", "transition"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion(Settings):
    """How the agent moves, and what is known of it before it does.

    Parameters
    ----------
    acceleration_variance : float
        Driving noise of the near-constant-velocity motion (39), m^2/s^4 per axis.
    velocity_std_m_s : float
        Standard deviation of the agent's unknown initial velocity, per axis.
    turn_rate_hz : float
        How often the agent turns suddenly, times a second: it goes on with a velocity of which only
        ``velocity_std_m_s`` is known. At most half of the probability goes to a turn within a step.
    max_speed_m_s : float
        Largest speed, as a device knows it of itself, metres a second; 0 where it is not known.
    speed_slack : float
        Share of the largest speed that it may be exceeded by: one standard deviation.
    start_std_m : float
        Standard deviation of the agent's initial position about RP, per axis, metres; 0 where
        the start defines the frame.
    """

    acceleration_variance: float = positive(0.0278)
    velocity_std_m_s: float = positive(1.0)
    turn_rate_hz: float = not_negative(0.04)
    max_speed_m_s: float = not_negative(0.0)
    speed_slack: float = positive(0.1)
    start_std_m: float = not_negative(0.0)


def transition(step_s: float) -> Array:
    """Matrix A of (39) for (x, y, vx, vy)."""
    matrix = np.eye(4)
    matrix[0, 2] = matrix[1, 3] = step_s
    return matrix


def process_noise(step_s: float, acceleration_variance: float) -> Array:
    """Covariance (4, 4) of the driving noise: an acceleration held over the step."""
    gain = np.array([[0.5 * step_s**2, 0.0], [0.0, 0.5 * step_s**2], [step_s, 0.0], [0.0, step_s]])
    return np.asarray(acceleration_variance * gain @ gain.T)


@compiled
def predict_motion(mean: Array, covariance: Array, step_s: float, acceleration_variance: float) -> None:
    """Move the agent of a Gaussian on by one step, in place; anchors and walls stay."""
    n = mean.size
    for a in range(2):
        mean[a] += step_s * mean[2 + a]
        for j in range(n):
            covariance[a, j] += step_s * covariance[2 + a, j]
    for i in range(n):
        for a in range(2):
            covariance[i, a] += step_s * covariance[i, 2 + a]
    place, speed = 0.5 * step_s * step_s, step_s
    for a in range(2):
        covariance[a, a] += acceleration_variance * place * place
        covariance[a, 2 + a] += acceleration_variance * place * speed
        covariance[2 + a, a] += acceleration_variance * place * speed
        covariance[2 + a, 2 + a] += acceleration_variance * speed * speed
    for i in range(4):  # rounding leaves the block of the agent unsymmetric
        for j in range(n):
            if j >= 4 or j > i:
                mid = 0.5 * (covariance[i, j] + covariance[j, i])
                covariance[i, j] = mid
                covariance[j, i] = mid
