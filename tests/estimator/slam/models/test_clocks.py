"""Biases and scales: their prior, how they change, and what path lengths they give."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.slam.models.clocks import Clocks, clock_prior, predict_clocks
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import Layout
from estimator.waveform import SPEED_OF_LIGHT_M_S

LAYOUT = Layout(3, 1)
BIAS = [LAYOUT.bias(k) for k in range(3)]
SCALE = [LAYOUT.scale(k) for k in range(3)]


def test_the_prior_has_what_is_alike_and_what_is_apart():
    """Biases each for itself or common, a free one for all; scales alike but for their share apart."""
    covariance = np.zeros((LAYOUT.size, LAYOUT.size))
    clock_prior(covariance, LAYOUT, Clocks(clock_bias_std_m=2.0, clock_free_std_m=3.0, range_scale_std=0.1))
    np.testing.assert_allclose(covariance[np.ix_(BIAS, BIAS)], 4.0 * np.eye(3) + 9.0)
    scale = covariance[np.ix_(SCALE, SCALE)]
    np.testing.assert_allclose(np.diag(scale), 0.01)
    np.testing.assert_allclose(scale[0, 1], 0.01 * 0.99)
    clock_prior(covariance, LAYOUT, Clocks(clock_bias_std_m=2.0, clock_bias_common=True))
    np.testing.assert_allclose(covariance[np.ix_(BIAS, BIAS)], 4.0)
    assert not covariance[np.ix_(SCALE, SCALE)].any()


@pytest.mark.parametrize("common", [False, True])
def test_biases_walk(common):
    """A millionth of a second a second is 300 m: variance grows with time, of each or of all."""
    clocks = Clocks(clock_walk_ppm=0.01, clock_bias_common=common)
    covariance = np.zeros((LAYOUT.size, LAYOUT.size))
    for _ in range(4):
        predict_clocks(LAYOUT, covariance, 0.5, clocks.model)
    variance = 2.0 * (1e-8 * SPEED_OF_LIGHT_M_S) ** 2
    expected = variance * (np.ones((3, 3)) if common else np.eye(3))
    np.testing.assert_allclose(covariance[np.ix_(BIAS, BIAS)], expected)
    assert covariance.sum() == pytest.approx(expected.sum())


def test_a_free_bias_leaves_differences_alone():
    """What all lengths have in common is new; how biases differ stays known."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(LAYOUT.size, LAYOUT.size))
    covariance = root @ root.T
    after = covariance.copy()
    predict_clocks(LAYOUT, after, 1.0, Clocks(clock_free_std_m=100.0).model)
    difference = np.zeros(LAYOUT.size)
    difference[BIAS[0]], difference[BIAS[2]] = 1.0, -1.0
    assert difference @ after @ difference == pytest.approx(difference @ covariance @ difference)
    assert after[BIAS[1], BIAS[1]] == pytest.approx(covariance[BIAS[1], BIAS[1]] + 1e4)


def test_lengths_are_scaled_and_their_derivatives_exact():
    """(1 + s) sqrt(d^2 + w) + b of a line of sight and a bounce, against differences of the whole vector."""
    mean = np.zeros(LAYOUT.size)
    mean[:2] = 1.0, 2.0
    for k in range(3):
        mean[LAYOUT.anchor(k)] = 4.0 + k, 6.0 - 2.0 * k, 1.5, 0.3
        mean[LAYOUT.scale(k)] = 0.07
    mean[LAYOUT.walls] = 20.0, 0.0
    prediction = predict_paths(mean[None], LAYOUT)
    assert prediction.length_m[0, 0, 0] == pytest.approx(1.07 * np.sqrt(3.0**2 + 4.0**2 + 1.5) + 0.3)
    for i in range(LAYOUT.size):
        step = np.zeros(LAYOUT.size)
        step[i] = 1e-5
        up, down = (predict_paths((mean + sign * step)[None], LAYOUT).length_m[0] for sign in (1.0, -1.0))
        slope = (up - down)[:, :2] / 2e-5
        np.testing.assert_allclose(prediction.jacobian[0, :, :2, i], slope, atol=1e-7)


def test_settings_are_checked():
    """A negative walk is none."""
    with pytest.raises(ConfigurationError, match=r"Clocks.clock_walk_ppm: expected zero or a positive"):
        Clocks(clock_walk_ppm=-1.0)
