"""Motion against matrices: a dense prediction of the whole state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimator.errors import ConfigurationError
from estimator.slam.models.motion import Motion, predict_motion, process_noise, transition


def test_prediction_is_the_dense_one():
    """The agent moves, its correlations with walls move along, and the rest stays."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(9, 9))
    mean, covariance = rng.normal(size=9), root @ root.T
    a = block_diag(transition(0.7), np.eye(5))
    q = block_diag(process_noise(0.7, 0.3), np.zeros((5, 5)))
    expected, spread = a @ mean, a @ covariance @ a.T + q
    predict_motion(mean, covariance, Motion(acceleration_variance=0.3).driving(0.7))
    np.testing.assert_allclose(mean, expected, atol=1e-12)
    np.testing.assert_allclose(covariance, spread, atol=1e-12)
    assert np.array_equal(covariance, covariance.T)


def test_noise_is_an_acceleration_held_over_the_step():
    """Covariance of 100,000 sampled steps."""
    draws = np.random.default_rng(2).normal(size=(100_000, 2)) * np.sqrt(0.3)
    moved = np.concatenate([0.5 * 0.7**2 * draws, 0.7 * draws], axis=1)
    np.testing.assert_allclose(np.cov(moved.T), process_noise(0.7, 0.3), atol=0.003)


@pytest.mark.parametrize("memory_s", [0.0, 3.0])
def test_white_acceleration_does_not_depend_on_the_number_of_steps(memory_s):
    """Ten steps of a tenth add what one step adds; of a held acceleration they add a tenth of it."""
    motion, total = Motion(acceleration_density=0.4, velocity_memory_s=memory_s), np.zeros((4, 4))
    step = motion.driving(0.1)
    for _ in range(10):
        total = step.transition @ total @ step.transition.T + step.covariance
    np.testing.assert_allclose(total, motion.driving(1.0).covariance, rtol=1e-9, atol=1e-15)
    held = Motion(acceleration_variance=0.4).driving(0.7)
    np.testing.assert_allclose(held.covariance, process_noise(0.7, 0.4), atol=1e-15)


def test_a_velocity_is_forgotten_and_its_spread_stays():
    """After a long gap the velocity is that of any time, the agent as far as a walk at random goes."""
    memory, std = 4.0, 1.5
    motion = Motion(
        acceleration_density=2.0 * std**2 / memory, velocity_memory_s=memory, velocity_std_m_s=std
    )
    mean, covariance = np.array([0.0, 0.0, 2.0, -1.0]), np.diag([0.0, 0.0, std**2, std**2])
    predict_motion(mean, covariance, motion.driving(100.0))
    np.testing.assert_allclose(mean, [8.0, -4.0, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(np.diag(covariance)[2:], std**2)
    walk = 2.0 * std**2 * memory * (100.0 - memory * (1.0 - np.exp(-25.0)))
    np.testing.assert_allclose(np.diag(covariance)[:2], walk)


def test_settings_are_checked():
    """A negative variance would make velocities imaginary."""
    with pytest.raises(ConfigurationError, match=r"Motion.acceleration_variance: expected a positive"):
        Motion(acceleration_variance=-1.0)
