"""Mixture reduction: the moments stay, the order is by weight, and the size is bounded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

from estimator.slam.mixture_reduction import ReduceModel, Reduction, reduce_mixture, reduction_model
from estimator.slam.models.hypotheses import Hypotheses, moments
from estimator.slam.models.state_vector import Layout

LAYOUT = Layout(1, 1)
MODEL = ReduceModel(
    prune_nats=12.0, alike_sigma=0.7, unlikely_sigma=2.0, inflation=0.02, rounding_m=1e-3, most=100
)


def mixture(count, seed=1, apart=10.0):
    """Hypotheses at random places, ``apart`` standard deviations about each other."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, LAYOUT.size, LAYOUT.size))
    covariance = root @ root.swapaxes(1, 2) / LAYOUT.size + np.eye(LAYOUT.size)
    return Hypotheses(
        rng.normal(size=count),
        apart * rng.normal(size=(count, LAYOUT.size)),
        covariance,
        np.ones((count, 1), dtype=bool),
        np.ones((count, 1), dtype=bool),
        rng.random((count, 1, LAYOUT.features)),
        np.zeros((count, 1), dtype=np.int64),
    )


def whole(hypotheses):
    """Mean and covariance of the mixture."""
    weight = np.exp(hypotheses.log_weight - logsumexp(hypotheses.log_weight))
    return moments(weight, hypotheses.mean, hypotheses.covariance)


def test_merging_keeps_the_moments():
    """Mean, covariance and visibility of the whole mixture are what they were."""
    given = mixture(40, apart=0.3)
    done = reduce_mixture(given, MODEL)
    assert done.number < 40
    for before, after in zip(whole(given), whole(done), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-9)
    weights = [np.exp(each.log_weight - logsumexp(each.log_weight)) for each in (given, done)]
    visibility = [np.tensordot(w, each.visibility, 1) for w, each in zip(weights, (given, done), strict=True)]
    np.testing.assert_allclose(*visibility, atol=1e-12)


def test_the_likeliest_first_the_unlikely_not_at_all():
    """Sorted, normalised, and what is far below the best is dropped; the input stays as it is."""
    given = mixture(30)
    given.log_weight[5] = given.log_weight.max() - 12.5
    before = given.take(np.arange(30))
    done = reduce_mixture(given, MODEL)
    assert done.number == 29
    assert np.all(np.diff(done.log_weight) <= 0.0)
    assert logsumexp(done.log_weight) == pytest.approx(0.0, abs=1e-12)
    order = np.argsort(-np.delete(given.log_weight, 5), kind="stable")
    assert np.array_equal(done.mean, np.delete(given.mean, 5, axis=0)[order])
    for name in Hypotheses._fields:
        assert np.array_equal(getattr(given, name), getattr(before, name))


@pytest.mark.parametrize("field", ["located", "present"])
def test_hypotheses_of_other_walls_or_anchors_are_not_alike(field):
    """Merging a map with a wall and one without would have half a wall."""
    given = mixture(2, apart=0.0)
    assert reduce_mixture(given, MODEL).number == 1
    getattr(given, field)[1] = False
    assert reduce_mixture(given, MODEL).number == 2


@pytest.mark.parametrize(
    ("nats", "sigmas", "merged"), [(0.0, 0.6, True), (0.0, 0.8, False), (6.0, 1.5, True), (6.0, 2.5, False)]
)
def test_how_far_apart_is_alike(nats, sigmas, merged):
    """Equals merge within a fraction of a deviation; an unlikely one, which hardly widens, from farther."""
    given = mixture(2, apart=0.0)
    given.log_weight[:] = 0.0, -nats
    given.covariance[:] = np.eye(LAYOUT.size)
    given.mean[1, 3] += sigmas
    assert (reduce_mixture(given, MODEL).number == 1) == merged


def test_the_number_is_capped():
    """The likeliest are kept."""
    given = mixture(60)
    done = reduce_mixture(given, MODEL._replace(most=7))
    assert done.number == 7
    best = np.sort(given.log_weight)[::-1][:7]
    np.testing.assert_allclose(done.log_weight, best - logsumexp(best), atol=1e-12)


def test_memory_is_bounded():
    """With many anchors and walls fewer hypotheses are kept, and at least two."""
    settings = Reduction(max_memory_mib=1.0)
    few, many = (
        reduction_model(settings, layout, 12.0, 2.0, 100).most for layout in (Layout(2, 5), Layout(20, 60))
    )
    assert few == 100
    assert many == 2
    for layout in (Layout(2, 5), Layout(6, 12), Layout(8, 20)):
        each = 8 * (layout.size * (layout.size + 1) + layout.anchors * layout.features)
        assert reduction_model(settings, layout, 12.0, 2.0, 100).most * each <= max(2**20, 2 * each)
