"""Clouds of particles: resampling against its law, moments, draws."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.particle.cloud import gaussian_cloud, moments_of, resample, systematic


@pytest.mark.parametrize("draws", [60, 1000])
def test_every_parent_is_drawn_as_often_as_its_weight_says(draws):
    """Counts are floor or ceil of N w; their mean over many draws is N w."""
    rng = np.random.default_rng(3)
    weight = rng.gamma(0.5, size=60)
    expected = draws * weight / weight.sum()
    count = None if draws == 60 else draws  # by default as many as there are weights
    counts = np.array(
        [np.bincount(systematic(np.log(weight), rng, count), minlength=60) for _ in range(4000)]
    )
    assert np.all(counts.sum(axis=1) == draws)
    assert np.all(counts >= np.floor(expected))
    assert np.all(counts <= np.ceil(expected))
    # a count is Bernoulli about its floor: variance f (1 - f) with f the fraction
    fraction = expected - np.floor(expected)
    std = np.sqrt(fraction * (1.0 - fraction) / 4000)
    assert np.all(np.abs(counts.mean(axis=0) - expected) < 4.5 * std + 1e-9)


def test_weights_may_be_tiny_or_zero():
    """Log weights far below any float's exponent work; impossible parents get no children."""
    rng = np.random.default_rng(4)
    log_weight = np.array([-5000.0, -np.inf, -5000.0, -6000.0], dtype=np.float32)
    assert set(systematic(log_weight, rng).tolist()) == {0, 2}


def test_resampling_turns_a_prior_into_a_posterior():
    """Weighted by a Gaussian likelihood, a Gaussian cloud has the Kalman posterior's moments."""
    rng = np.random.default_rng(5)
    count = 200_000
    prior = np.array([[2.0, 0.6], [0.6, 0.5]])
    cloud = gaussian_cloud([1.0, -2.0], prior, count, rng)
    log_weight = -0.5 * (cloud[0] - 2.0) ** 2 / 0.8
    mean, covariance = moments_of(resample(cloud, log_weight, rng))
    gain = prior[:, 0] / (prior[0, 0] + 0.8)
    exact_mean = np.array([1.0, -2.0]) + gain * 1.0
    exact = prior - np.outer(gain, prior[0])
    # effective number of particles about a third of N; five standard errors
    assert mean == pytest.approx(exact_mean, abs=5.0 * np.sqrt(3.0 / count))
    assert covariance == pytest.approx(exact, abs=5.0 * np.sqrt(6.0 / count))


def test_resampling_unties_pairs():
    """Two clouds resampled alike are paired at random: their indices start at other places."""
    cloud = np.arange(1000, dtype=np.float32)[None]
    rng = np.random.default_rng(6)
    flat = np.zeros(1000, dtype=np.float32)
    first, second = resample(cloud, flat, rng), resample(cloud, flat, rng)
    assert np.array_equal(np.sort(first[0]), cloud[0])
    assert np.mean(first == second) < 0.01


def test_singular_covariances_are_drawn_from():
    """A covariance of rank one gives points on a line, a zero one a single point."""
    rng = np.random.default_rng(7)
    line = gaussian_cloud([3.0, 4.0], np.ones((2, 2)), 1000, rng)
    assert np.allclose(line[0] - 3.0, line[1] - 4.0, atol=1e-5)
    assert np.array_equal(gaussian_cloud([3.0, 4.0], np.zeros((2, 2)), 5, rng), np.tile([[3.0], [4.0]], 5))
