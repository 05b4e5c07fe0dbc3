"""Ambiguities of an epoch: branches are weighed together, as enumeration of all labellings does."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from estimator.slam.gaussian.branches import copy_branch, empty_branches, room_for
from estimator.slam.gaussian.branching import Branching
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.models.state_vector import Layout
from tests.estimator.slam.gaussian.test_update import one_hypothesis, path_table, taken

CONFIG = GaussianConfig.of(range_std_m=0.1, region_m=3000.0, clutter_mean=3.0)
LAYOUT = Layout(3, 0, shared=False)
BEARING = np.radians([0.0, 120.0, 225.0])
DISTANCE = np.array([1000.0, 1400.0, 2000.0])
VISIBLE = 0.9


def heard(step, rng):
    """Path lengths (3, 2): from anchors a kilometre or two away to the agent, and a false one of each."""
    towards = np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
    true = np.linalg.norm(towards * DISTANCE[:, None] - step, axis=1) + 0.1 * rng.normal(size=3)
    return np.stack([true, DISTANCE + rng.normal(size=3)], axis=1)


def branched(lengths, config=CONFIG):
    """The hypotheses after an epoch with these lengths, of an agent that is known to a metre."""
    mean, covariance = np.zeros(LAYOUT.size), np.zeros((LAYOUT.size, LAYOUT.size))
    for k, distance in enumerate(DISTANCE.tolist()):
        mean[LAYOUT.anchor_xy(k)] = distance * np.cos(BEARING[k]), distance * np.sin(BEARING[k])
    covariance[:2, :2] = np.eye(2)
    hypothesis = one_hypothesis(LAYOUT, mean, covariance, VISIBLE, [])
    return taken(LAYOUT, hypothesis, path_table(lengths, 0.1), config)


def enumerated(lengths):
    """Log evidence of every labelling (each anchor's path, -1 for none), over "all is clutter"."""
    h = -np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
    gap = lengths - DISTANCE[:, None]
    chance = VISIBLE * CONFIG.noise.detection_probability
    result = {}
    for label in product((-1, 0, 1), repeat=3):
        used = [k for k in range(3) if label[k] >= 0]
        total = len(used) * np.log(chance / CONFIG.noise.clutter_density)
        total += (3 - len(used)) * np.log(1.0 - chance)
        if used:
            covariance = h[used] @ h[used].T + 0.01 * np.eye(len(used))
            innovation = [gap[k, label[k]] for k in used]
            total += multivariate_normal.logpdf(innovation, np.zeros(len(used)), covariance)
        result[label] = float(total)
    return result


@pytest.mark.parametrize("seed", range(12))
def test_branches_are_weighed_as_enumeration_says(seed):
    """The evidence of all branches is that of all labellings, and the likeliest ones' shares are theirs."""
    rng = np.random.default_rng(seed)
    lengths = heard(rng.normal(size=2), rng)
    done, exact = branched(lengths), enumerated(lengths)
    weight = done.hypotheses.log_weight
    assert logsumexp(weight) == pytest.approx(logsumexp(list(exact.values())), abs=0.03)
    for row in np.flatnonzero(weight > weight.max() - 3.0):
        share = done.explained[row]  # how surely each path was taken, (3, 2)
        if np.all((share < 0.01) | (share > 0.99)):
            label = tuple(int(np.argmax(each)) if each.max() > 0.5 else -1 for each in share)
            assert weight[row] == pytest.approx(exact[label], abs=0.03)


def test_paths_that_agree_beat_those_that_fit_best_alone():
    """A false path nearer to what is expected than the true one, for two anchors of three: it moved."""
    done = branched(np.array([[998.2, 1000.1], [1400.9, 1400.0], [2001.27, 2013.0]]))
    best = done.hypotheses.best
    assert np.argmax(done.explained[best], axis=1).tolist() == [0, 0, 0]
    assert done.hypotheses.mean[best, :2] == pytest.approx([1.8, 0.0], abs=0.2)


def test_every_ambiguity_of_an_epoch_is_decided_both_ways():
    """Two lines of sight missed, clutter near each: a hypothesis that took neither remains, and stays put."""
    layout = Layout(2, 0, shared=False)
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    mean[layout.anchor(0)], mean[layout.anchor(1)] = (50.0, 0.0, 0.0, 0.0), (0.0, 30.0, 0.0, 0.0)
    covariance[:2, :2] = np.eye(2)
    length = np.array([[51.5], [28.2]])  # 1.5 and 1.8 m from where the lines of sight are expected
    config = GaussianConfig.of(range_std_m=0.1, region_m=180.0)
    done = taken(layout, one_hypothesis(layout, mean, covariance, 0.9, []), path_table(length, 0.1), config)
    took, after = done.detected[..., 0] > 0.5, done.hypotheses
    assert sorted(took.tolist()) == [[False, False], [False, True], [True, False], [True, True]]
    neither = int(np.flatnonzero(~took.any(axis=1))[0])
    np.testing.assert_allclose(after.mean[neither, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(after.covariance[neither], covariance, atol=1e-9)
    both = int(np.flatnonzero(took.all(axis=1))[0])
    np.testing.assert_allclose(after.mean[both, :2], [-1.485, 1.78], atol=0.05)
    assert after.log_weight[both] > after.log_weight[neither]


@pytest.mark.parametrize("apart", [0.2, 0.35, 0.5])
def test_two_paths_that_cross_keep_both_labellings(apart):
    """Line of sight and virtual anchor, expected 10 cm apart: branches of both, exactly weighed."""
    layout = Layout(1, 1, shared=False)
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    sight, image = layout.anchor(0).start, layout.wall(0).start
    mean[sight], mean[image], mean[image + 1] = 50.0, 50.1, 0.5 * np.pi  # distances and a bearing
    expected, std = np.array([50.0, 50.1]), np.array([0.3, 0.3])
    covariance[sight, sight], covariance[image, image] = std**2
    heard_m = np.array([50.05 - 0.5 * apart, 50.05 + 0.5 * apart])
    config = GaussianConfig.of(range_std_m=0.1)
    hypothesis = one_hypothesis(layout, mean, covariance, 0.99, [True])
    done = taken(layout, hypothesis, path_table(heard_m[None], 0.1), config, np.array([0]))
    spread = np.hypot(std, 0.1)
    odds = norm.logpdf(heard_m, expected, spread).sum() - norm.logpdf(heard_m[::-1], expected, spread).sum()
    both = done.detected.sum(axis=(1, 2)) > 1.99
    straight = done.hypotheses.mean[:, sight] < 50.05
    one, other = (logsumexp(done.hypotheses.log_weight[both & kind]) for kind in (straight, ~straight))
    assert one - other == pytest.approx(odds, abs=0.02)


def test_branches_are_bounded():
    """However ambiguous an epoch is, there are no more hypotheses than asked for; the rest is matched."""
    rng = np.random.default_rng(5)
    lengths = DISTANCE[:, None] + rng.uniform(-3.0, 3.0, (3, 29))
    free = branched(lengths).hypotheses.number
    few = branched(lengths, CONFIG.but(most_branches=40)).hypotheses.number
    none = branched(lengths, CONFIG.but(most_branches=1)).hypotheses
    assert free > 100
    assert few <= 40
    assert none.number == 1
    assert np.isfinite(none.mean).all()
    assert np.all(np.linalg.eigvalsh(none.covariance[0]) > -1e-9)


def test_nothing_branches_where_the_spread_is_small():
    """Alternatives that would hardly move the hypothesis are matched by moments: one hypothesis stays."""
    lengths = DISTANCE[:, None] + np.array([[0.0, 0.05]] * 3)
    assert branched(lengths, CONFIG.but(spread_ratio=50.0)).hypotheses.number == 1
    assert Branching(spread_ratio=50.0).spread_ratio == 50.0


def test_room_grows_and_keeps_what_is_there():
    """A copy that shared memory, or a growth that lost a branch, would mix hypotheses."""
    rng = np.random.default_rng(1)
    branches = empty_branches(2, 3, 1, 2, 4)
    for column in branches:
        column[...] = rng.integers(0, 2, column.shape)
    grown = room_for(branches, 5)
    assert room_for(grown, 6) is grown or len(room_for(grown, 6).mean) >= 6
    assert len(grown.mean) >= 5
    copy_branch(grown, 1, 4)
    for old, new in zip(branches, grown, strict=True):
        assert np.array_equal(new[:2], old)
        assert np.array_equal(new[4], old[1])
    grown.mean[4] = 7.0
    assert not np.array_equal(grown.mean[1], grown.mean[4])
