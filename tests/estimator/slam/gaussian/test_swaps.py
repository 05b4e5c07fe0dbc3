"""Two paths that cross: exchanges weighed exactly, and both labellings kept."""

from __future__ import annotations

import numpy as np
import pytest
from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.swaps import exchange_odds, with_exchange
from estimator.slam.layout import Layout
from scipy.stats import norm

from estimator.slam.association import associate
from estimator.slam.gaussian.update import correct
from tests.estimator.slam.test_association import enumerate_all


def test_exchanges_are_as_likely_as_enumeration_says():
    """Two features that surely were measured: belief propagation is too sure, mended it is not."""
    rng = np.random.default_rng(3)
    ratio = np.exp(rng.uniform(5.0, 9.0, size=(60, 2, 2)))
    found = associate(ratio).probability
    exact = np.array([enumerate_all(each)[0] for each in ratio])
    assert np.abs(found - exact).max() > 0.15
    assert np.abs(with_exchange(found, ratio) - exact).max() < 0.04


def test_what_is_not_contested_stays():
    """Features with a path each, or none, have no exchange and keep their probabilities bit for bit."""
    ratio = np.zeros((1, 3, 3))
    ratio[0, 0, 0], ratio[0, 1, 2], ratio[0, 1, 1] = 900.0, 50.0, 40.0
    share = associate(ratio).probability
    assert np.array_equal(with_exchange(share, ratio), share)
    assert not exchange_odds(ratio, np.array([[0, 2, -1]])).any()


@pytest.mark.parametrize("apart", [0.2, 0.35, 0.5])
def test_both_labellings_are_kept_by_their_odds(apart):
    """Line of sight and virtual anchor, expected 10 cm apart: rows of both labellings, exactly weighed."""
    layout = Layout(1, 1, shared=False)
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    sight, image = layout.anchor(0).start, layout.wall(0).start
    mean[sight], mean[image], mean[image + 1] = 50.0, 50.1, 0.5 * np.pi  # distances and a bearing
    expected, std = np.array([50.0, 50.1]), np.array([0.3, 0.3])
    covariance[sight, sight] = std[0] ** 2
    covariance[image, image] = std[1] ** 2
    heard = np.array([50.05 - 0.5 * apart, 50.05 + 0.5 * apart])
    paths = PathTable(heard[None], np.full((1, 2), 0.1), np.full((1, 2), np.nan), np.ones((1, 2), dtype=bool))
    everywhere = np.ones((1, 1, 2))
    done = correct(
        mean[None],
        covariance[None],
        0.99 * everywhere,
        everywhere > 0.0,
        paths,
        layout,
        GaussianConfig(range_std_m=0.1),
    )
    spread = np.hypot(std, 0.1)
    odds = norm.logpdf(heard, expected, spread).sum() - norm.logpdf(heard[::-1], expected, spread).sum()
    both = done.heard.sum(axis=(1, 2)) > 1.99
    straight = done.mean[:, sight] < 50.05
    straight, swapped = (
        np.logaddexp.reduce(done.log_evidence[both & kind]) for kind in (straight, ~straight)
    )
    assert straight - swapped == pytest.approx(odds, abs=0.02)
