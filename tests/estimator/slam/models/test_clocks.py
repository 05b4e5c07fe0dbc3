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
        predict_clocks(LAYOUT, np.zeros(LAYOUT.size), covariance, 0.5, clocks.model)
    variance = 2.0 * (1e-8 * SPEED_OF_LIGHT_M_S) ** 2
    expected = variance * (np.ones((3, 3)) if common else np.eye(3))
    np.testing.assert_allclose(covariance[np.ix_(BIAS, BIAS)], expected)
    assert covariance.sum() == pytest.approx(expected.sum())


@pytest.mark.parametrize("constant_std", [0.0, 0.5])
def test_a_free_bias_is_forgotten_and_differences_are_not(constant_std):
    """What all lengths have in common is new, whatever was told before; how biases differ stays known."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(LAYOUT.size, LAYOUT.size))
    covariance = root @ root.T
    mean = rng.normal(size=LAYOUT.size)
    clocks = Clocks(clock_bias_std_m=constant_std, clock_free_std_m=100.0)
    after, moved = covariance.copy(), mean.copy()
    for _ in range(5):
        predict_clocks(LAYOUT, moved, after, 1.0, clocks.model)
    assert np.array_equal(after, after.T)
    difference = np.zeros(LAYOUT.size)
    difference[BIAS[0]], difference[BIAS[2]] = 1.0, -1.0
    assert difference @ after @ difference == pytest.approx(difference @ covariance @ difference)
    assert difference @ moved == pytest.approx(difference @ mean)
    common = np.zeros(LAYOUT.size)
    common[BIAS] = 1.0 / 3.0
    assert common @ after @ common == pytest.approx(1e4 + constant_std**2 / 3.0, rel=1e-4)
    assert common @ moved == pytest.approx(0.0, abs=1e-3)
    other = np.setdiff1d(np.arange(LAYOUT.size), BIAS)
    np.testing.assert_array_equal(after[np.ix_(other, other)], covariance[np.ix_(other, other)])
    np.testing.assert_allclose((common @ after)[other], 0.0, atol=1e-2)


def test_a_free_clock_of_one_anchor_tells_nothing():
    """With one anchor the bias is all that is common: nothing of it stays."""
    layout = Layout(1, 1)
    covariance, mean = np.eye(layout.size), np.ones(layout.size)
    covariance[0, layout.bias(0)] = covariance[layout.bias(0), 0] = 0.5
    predict_clocks(layout, mean, covariance, 1.0, Clocks(clock_free_std_m=3.0).model)
    assert mean[layout.bias(0)] == 0.0
    assert covariance[layout.bias(0), layout.bias(0)] == pytest.approx(9.0)
    assert covariance[0, layout.bias(0)] == 0.0


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
