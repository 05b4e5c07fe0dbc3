"""Motion of the agent: near-constant velocity (equation (39)), or what odometry measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.settings import Settings, not_negative, positive
from estimator.slam.models.state_vector import HEADING

__all__ = ["Driving", "Motion", "predict_by_odometry", "predict_motion", "process_noise", "transition"]

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
        Standard deviation of the agent's unknown initial velocity, per axis; half the largest speed where
        that is less.
    turn_rate_hz : float
        How often the agent turns suddenly, times a second: it goes on with a velocity of which only
        ``velocity_std_m_s`` is known. At most half of the probability goes to a turn within a step.
    max_speed_m_s : float
        Largest speed, as a device knows it of itself, metres a second; 0 where it is not known.
    speed_slack : float
        Share of the largest speed that it may be exceeded by: one standard deviation.
    body_turn_std_rad : float
        Standard deviation of the turn of the agent's body in a second of which no odometry tells: a walker's,
        who goes round a corner now and then.
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
    body_turn_std_rad: float = not_negative(0.3)
    start_std_m: float = not_negative(0.0)

    @property
    def speed_std_m_s(self) -> float:
        """Standard deviation per axis of a velocity of which nothing else is known, metres a second."""
        return 0.5 * self.max_speed_m_s or self.velocity_std_m_s

    @property
    def start_velocity_std_m_s(self) -> float:
        """Standard deviation per axis of the agent's velocity at the start, metres a second."""
        return min(self.velocity_std_m_s, self.speed_std_m_s)

    @property
    def fastest_m_s(self) -> float:
        """A speed that the agent never has, metres a second."""
        if self.max_speed_m_s > 0.0:
            return self.max_speed_m_s * (1.0 + 2.0 * self.speed_slack)
        return 5.0 * self.velocity_std_m_s

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


@compiled
def predict_by_odometry(
    mean: Array, covariance: Array, step_s: float, displacement_m: Array, turn_rad: float, spread: Array
) -> None:
    """Move the agent of a Gaussian on by what odometry measured, in place; anchors and walls stay.

    With the body's direction psi and R its rotation, to first order in all errors::

        p <- p + R(psi) d,   v <- R(psi) d / T,   psi <- psi + turn

    Parameters
    ----------
    mean, covariance : ndarray, shape (n,), (n, n)
        The Gaussian.
    step_s : float
        Time T since the epoch before, seconds.
    displacement_m : ndarray, shape (2,)
        d, in the body's axes at the epoch before, metres.
    turn_rad : float
        Turn of the body, radians.
    spread : ndarray, shape (3, 3)
        Covariance of both.
    """
    n = mean.size
    cos, sin = np.cos(mean[HEADING]), np.sin(mean[HEADING])
    moved = np.empty(2)
    moved[0] = cos * displacement_m[0] - sin * displacement_m[1]
    moved[1] = sin * displacement_m[0] + cos * displacement_m[1]
    by_heading = np.empty(2)
    by_heading[0], by_heading[1] = -moved[1], moved[0]
    # derivatives of (x, y, vx, vy, psi) by (dx, dy, turn)
    index = np.array([0, 1, 2, 3, HEADING])
    gain = np.zeros((5, 3))
    gain[0, 0], gain[0, 1] = cos, -sin
    gain[1, 0], gain[1, 1] = sin, cos
    gain[2, 0], gain[2, 1] = cos / step_s, -sin / step_s
    gain[3, 0], gain[3, 1] = sin / step_s, cos / step_s
    gain[4, 2] = 1.0
    for a in range(2):
        mean[a] += moved[a]
        mean[2 + a] = moved[a] / step_s
        for j in range(n):
            covariance[a, j] += by_heading[a] * covariance[HEADING, j]
            covariance[2 + a, j] = by_heading[a] / step_s * covariance[HEADING, j]
    mean[HEADING] += turn_rad
    for i in range(n):
        for a in range(2):
            covariance[i, a] += by_heading[a] * covariance[i, HEADING]
            covariance[i, 2 + a] = by_heading[a] / step_s * covariance[i, HEADING]
    for a in range(5):
        for b in range(5):
            noise = 0.0
            for c in range(3):
                for d in range(3):
                    noise += gain[a, c] * spread[c, d] * gain[b, d]
            covariance[index[a], index[b]] += noise
    for i in range(4):  # rounding leaves the block of the agent unsymmetric
        for j in range(n):
            if j >= 4 or j > i:
                mid = 0.5 * (covariance[i, j] + covariance[j, i])
                covariance[i, j] = mid
                covariance[j, i] = mid
