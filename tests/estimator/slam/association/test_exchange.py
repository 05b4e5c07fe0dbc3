"""Two paths that cross: exchanges weighed exactly."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.association.belief_propagation import associate_all
from estimator.slam.association.exchange import best_exchange, with_exchange
from tests.estimator.slam.association.test_belief_propagation import enumerate_all


def test_exchanges_are_as_likely_as_enumeration_says():
    """Two features that surely were measured: belief propagation is too sure, mended it is not."""
    ratio = np.exp(np.random.default_rng(3).uniform(5.0, 9.0, size=(60, 2, 2)))
    found = associate_all(ratio)[0]
    exact = np.array([enumerate_all(each)[0] for each in ratio])
    assert np.abs(found - exact).max() > 0.15
    for each, own in zip(found, ratio, strict=True):
        with_exchange(each, own)
    assert np.abs(found - exact).max() < 0.04
    assert found.sum(axis=2) == pytest.approx(exact.sum(axis=2), abs=0.02)


def test_what_is_not_contested_stays():
    """Features with a path each, or none, have no exchange and keep their probabilities bit for bit."""
    ratio = np.zeros((3, 3))
    ratio[0, 0], ratio[1, 2], ratio[1, 1] = 900.0, 50.0, 40.0
    share = associate_all(ratio[None])[0][0]
    before = share.copy()
    with_exchange(share, ratio)
    assert np.array_equal(share, before)
    label = np.array([0, 2, -1])
    for f in range(3):
        assert best_exchange(ratio, label, f) == (-1, 0.0)


def test_the_partner_is_the_one_with_the_best_odds():
    """Of three features on three paths, by the ratio of four."""
    ratio = np.exp(np.random.default_rng(4).normal(size=(3, 3)))
    label = np.array([0, 1, 2])
    odds = [ratio[0, g] * ratio[g, 0] / (ratio[0, 0] * ratio[g, g]) for g in (1, 2)]
    partner, best = best_exchange(ratio, label, 0)
    assert best == pytest.approx(max(odds))
    assert partner == 1 + int(np.argmax(odds))
