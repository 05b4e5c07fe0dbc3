"""Guesses of a free clock bias: what most paths agree on, weighed by the prior."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch
from estimator.slam.gaussian.clock_guesses import ClockGuesses, with_clock_guesses
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.state_vector import Layout
from estimator.waveform import SPEED_OF_LIGHT_M_S

LAYOUT = Layout(5, 1)
ANGLE = 2.0 * np.pi * np.arange(5) / 5.0
PLACES = np.stack([20.0 * np.cos(ANGLE) + 3.0, 15.0 * np.sin(ANGLE)], axis=1)
BIAS = [LAYOUT.bias(k) for k in range(5)]
LENGTHS = np.linalg.norm(PLACES, axis=1)


def hypothesis(bias_std: float) -> Hypotheses:
    """An agent at the origin, known to 0.1 m, and a bias that is common to five anchors."""
    mean, covariance = np.zeros(LAYOUT.size), np.zeros((LAYOUT.size, LAYOUT.size))
    for k in range(5):
        mean[LAYOUT.anchor_xy(k)] = PLACES[k]
    mean[LAYOUT.walls] = 90.0, 0.0
    covariance[:2, :2] = 0.01 * np.eye(2)
    covariance[np.ix_(BIAS, BIAS)] = bias_std**2
    return Hypotheses(
        np.zeros(1),
        mean[None],
        covariance[None],
        np.ones((1, 5), dtype=bool),
        np.zeros((1, 1), dtype=bool),
        np.full((1, 5, 3), 0.9),
        np.zeros((1, 1), dtype=np.int64),
    )


def guessed(hypotheses: Hypotheses, lengths: list[list[float]], **settings: float) -> Hypotheses:
    """The hypotheses with guesses from paths of 0.1 m."""
    paths = tuple(
        AnchorPaths(np.array(own) / SPEED_OF_LIGHT_M_S, np.full(len(own), 0.1 / SPEED_OF_LIGHT_M_S))
        for own in lengths
    )
    table = stack_paths(Epoch(0, 0.0, paths), 6e9)
    confirmed, owner = np.zeros(1, dtype=bool), np.full(1, -1)
    return with_clock_guesses(
        LAYOUT, hypotheses, confirmed, owner, table, np.full(5, 0.02), 0.95, ClockGuesses(**settings)
    )


def test_the_bias_that_most_paths_agree_on():
    """Five lines of sight are 7 m too long, and there is clutter: one guess is left, near enough."""
    rng = np.random.default_rng(3)
    lengths = [[length + 7.0 + 0.1 * rng.normal(), *rng.uniform(1.0, 60.0, 2)] for length in LENGTHS]
    after = guessed(hypothesis(10.0), lengths)
    assert after.number == 1
    assert after.mean[0, BIAS] == pytest.approx(7.0, abs=0.4)
    assert np.ptp(after.mean[0, BIAS]) == 0.0
    variance = after.covariance[0][np.ix_(BIAS, BIAS)]
    assert np.ptp(variance) == pytest.approx(0.0, abs=1e-9)
    assert 1.0 < variance[0, 0] < 2.0
    assert after.log_weight[0] == pytest.approx(-0.5 * (0.07 * 7.0 + np.log(100.0 / variance[0, 0])), abs=0.1)


def test_two_biases_that_fit_are_two_hypotheses():
    """Every line of sight has a twin 5 m later: the prior prefers the smaller bias, by its density."""
    after = guessed(hypothesis(10.0), [[length + 1.0, length + 6.0] for length in LENGTHS])
    order = np.argsort(after.mean[:, BIAS[0]])
    np.testing.assert_allclose(after.mean[order, BIAS[0]], [1.0, 6.0], atol=0.3)
    weight = after.log_weight[order]
    assert weight[0] - weight[1] == pytest.approx(0.5 * (36.0 - 1.0) / 100.0, abs=0.03)


def test_what_paths_do_not_tell_is_not_guessed():
    """One path a feature, none of which agree; a bias that is known; no path at all: as they were."""
    for before, lengths in (
        (hypothesis(100.0), [[length + 9.0 * k] for k, length in enumerate(LENGTHS)]),
        (hypothesis(0.5), [[length + 0.2] for length in LENGTHS]),
        (hypothesis(10.0), [[]] * 5),
    ):
        after = guessed(before, lengths, most_guesses=3)
        assert after.number == 1
        np.testing.assert_array_equal(after.mean, before.mean)
        np.testing.assert_array_equal(after.covariance, before.covariance)
