"""Clouds of particles: resampling against its law, moments, draws."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.particle.cloud import (
    gaussian_cloud,
    moments_of,
    moved,
    normals,
    resample,
    systematic,
    total_variance,
)


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


@pytest.mark.parametrize("count", [1, 31, 1000])
def test_moments_are_those_of_every_particle(count):
    """Means, covariances and their trace, far from the origin, whatever is left over of the lanes."""
    cloud = (np.random.default_rng(8).normal(size=(3, count)) + [[1e3], [0.0], [-50.0]]).astype(np.float32)
    exact = cloud.astype(np.float64)
    mean, covariance = moments_of(cloud)
    assert mean == pytest.approx(exact.mean(axis=1), rel=1e-12)
    assert covariance == pytest.approx(np.cov(exact, bias=True), abs=1e-9)
    place, total = total_variance(cloud)
    assert place == pytest.approx(mean, rel=1e-12)
    assert total == pytest.approx(np.trace(covariance), abs=1e-9)


def test_normal_numbers_are_normal():
    """Moments up to the fourth, independence of the halves made together, and the share of the tail."""
    count = 400_000
    values = normals(count + 1, np.random.default_rng(9)).astype(np.float64)
    assert len(values) == count + 1
    for power, moment in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0)):
        spread = np.sqrt(np.prod(np.arange(1, 2 * power, 2)) / count)  # of the mean of a power
        assert np.mean(values**power) == pytest.approx(moment, abs=5.0 * spread)
    first, second = values[: count // 2], values[count // 2 + 1 :]
    assert abs(np.mean(first * second)) < 5.0 / np.sqrt(count / 2)
    assert abs(np.mean((first**2 - 1.0) * (second**2 - 1.0))) < 10.0 / np.sqrt(count / 2)
    share = np.mean(np.abs(values) > 3.0)
    assert share == pytest.approx(0.0026998, abs=5.0 * np.sqrt(0.0027 / count))


def test_motion_moves_mean_and_covariance():
    """A cloud times a matrix plus noise has the moments of the Kalman filter's prediction."""
    rng, count = np.random.default_rng(10), 200_000
    matrix, noise = np.array([[1.0, 0.5], [0.0, 1.0]]), 0.3 * np.ones((2, 2))
    before = np.array([[2.0, 0.6], [0.6, 0.5]])
    cloud = gaussian_cloud([1.0, -2.0], before, count, rng)
    mean, covariance = moments_of(moved(cloud, matrix, noise, rng))
    exact = matrix @ before @ matrix.T + noise
    assert mean == pytest.approx(matrix @ [1.0, -2.0], abs=5.0 * np.sqrt(exact.max() / count))
    assert covariance == pytest.approx(exact, abs=5.0 * exact.max() * np.sqrt(2.0 / count))
