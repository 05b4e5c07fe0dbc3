"""Gaussian mixtures: moments, weights, taking and joining."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp, moments, normalised_weights


def some(count, seed=1):
    """Random hypotheses of one anchor and one wall."""
    rng = np.random.default_rng(seed)
    return Hypotheses(
        rng.normal(size=count),
        rng.normal(size=(count, 11)),
        rng.normal(size=(count, 11, 11)),
        rng.random((count, 1)) < 0.5,
        rng.random((count, 1)) < 0.5,
        rng.random((count, 1, 3)),
        rng.integers(0, 9, (count, 1)),
    )


def test_moments_are_those_of_a_sample():
    """The mixture's mean and covariance, of 200,000 draws."""
    rng = np.random.default_rng(3)
    weight, mean = np.array([0.2, 0.5, 0.3]), np.array([[0.0, 1.0], [3.0, -1.0], [-2.0, 0.5]])
    root = rng.normal(size=(3, 2, 2))
    centre, covariance = moments(weight, mean, root @ root.swapaxes(1, 2))
    which = rng.choice(3, 200_000, p=weight)
    draws = mean[which] + np.einsum("nij,nj->ni", root[which], rng.normal(size=(200_000, 2)))
    np.testing.assert_allclose(centre, draws.mean(axis=0), atol=0.03)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.06)


def test_weights_without_overflow():
    """Log weights of thousands of epochs are far from zero."""
    values = np.array([-4000.0, -4001.0, -4010.0])
    assert log_sum_exp(values) == pytest.approx(logsumexp(values), abs=1e-9)
    weight = normalised_weights(values)
    assert weight.sum() == pytest.approx(1.0)
    assert weight[0] / weight[1] == pytest.approx(np.e)


def test_taking_copies_joining_appends_keeping_normalises():
    """A shared array would let one hypothesis change another."""
    one, other = some(4), some(3, 2)
    taken = one.take([2, 2])
    taken.mean[0] = 0.0
    assert one.mean[2].any()
    assert taken.mean[1].any()
    joined = one.joined(other)
    assert joined.number == 7
    for name in Hypotheses._fields:
        assert np.array_equal(getattr(joined, name)[4:], getattr(other, name))
    kept = one.keep(np.array([True, False, True, True]))
    assert np.exp(kept.log_weight).sum() == pytest.approx(1.0)
    assert np.array_equal(kept.mean, one.mean[[0, 2, 3]])
    assert one.best == int(np.argmax(one.log_weight))
