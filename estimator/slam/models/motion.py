"""Near-constant-velocity motion of the agent (equation (39))."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.settings import Settings, not_negative, positive

__all__ = ["Driving", "Motion", "predict_motion", "process_noise", "transition"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion(Settings):
    """How the agent moves, and what is known of it before it does.

    Parameters
    ----------
    acceleration_variance : float
        Driving noise of the near-constant-velocity motion (39), m^2/s^4 per axis: of an acceleration held
        over each step.
    acceleration_density : float
        Instead of it, where above 0, the spectral density of an acceleration that is white in time,
        m^2/s^3 per axis: what an agent does in a second is then the same, however many epochs it has.
    velocity_memory_s : float
        With ``acceleration_density``, velocities are forgotten at this time constant, seconds: in a gap
        between epochs the agent does not run away. 0 keeps them.
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
    acceleration_density: float = not_negative(0.0)
    velocity_memory_s: float = not_negative(0.0)
    velocity_std_m_s: float = positive(1.0)
    turn_rate_hz: float = not_negative(0.04)
    max_speed_m_s: float = not_negative(0.0)
    speed_slack: float = positive(0.1)
    start_std_m: float = not_negative(0.0)

    def driving(self, step_s: float) -> Driving:
        """What becomes of velocity in a step, and the covariance per axis that the driving noise adds."""
        q, memory = self.acceleration_density, self.velocity_memory_s
        if q > 0.0 and memory > 0.0:  # an integrated Ornstein-Uhlenbeck process
            kept = float(np.exp(-step_s / memory))
            gone = 1.0 - kept
            place = 0.5 * q * memory**3 * (2.0 * step_s / memory - 3.0 + 4.0 * kept - kept**2)
            speed = 0.5 * q * memory * (1.0 - kept**2)
            return Driving(memory * gone, kept, place, 0.5 * q * (memory * gone) ** 2, speed)
        if q > 0.0:
            return Driving(step_s, 1.0, q * step_s**3 / 3.0, q * step_s**2 / 2.0, q * step_s)
        a, place, speed = self.acceleration_variance, 0.5 * step_s * step_s, step_s
        return Driving(step_s, 1.0, a * place * place, a * place * speed, a * speed * speed)


class Driving(NamedTuple):
    """What a step does per axis.

    Parameters
    ----------
    reach_s : float
        How far a velocity takes the agent, seconds.
    kept : float
        Share of the velocity that is left.
    place, both, speed : float
        What the driving noise adds to the variance of place, to the covariance, and to the variance of
        velocity.
    """

    reach_s: float
    kept: float
    place: float
    both: float
    speed: float

    @property
    def transition(self) -> Array:
        """Matrix (4, 4) that moves (x, y, vx, vy)."""
        return np.asarray(np.kron([[1.0, self.reach_s], [0.0, self.kept]], np.eye(2)))

    @property
    def covariance(self) -> Array:
        """What the driving noise adds to the covariance of (x, y, vx, vy), shape (4, 4)."""
        return np.asarray(np.kron([[self.place, self.both], [self.both, self.speed]], np.eye(2)))


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
def predict_motion(mean: Array, covariance: Array, driving: Driving) -> None:
    """Move the agent of a Gaussian on by one step, in place; anchors and walls stay."""
    n = mean.size
    for a in range(2):
        mean[a] += driving.reach_s * mean[2 + a]
        mean[2 + a] *= driving.kept
        for j in range(n):
            covariance[a, j] += driving.reach_s * covariance[2 + a, j]
            covariance[2 + a, j] *= driving.kept
    for i in range(n):
        for a in range(2):
            covariance[i, a] += driving.reach_s * covariance[i, 2 + a]
            covariance[i, 2 + a] *= driving.kept
    for a in range(2):
        covariance[a, a] += driving.place
        covariance[a, 2 + a] += driving.both
        covariance[2 + a, a] += driving.both
        covariance[2 + a, 2 + a] += driving.speed
    for i in range(4):  # rounding leaves the block of the agent unsymmetric
        for j in range(n):
            if j >= 4 or j > i:
                mid = 0.5 * (covariance[i, j] + covariance[j, i])
                covariance[i, j] = mid
                covariance[j, i] = mid
