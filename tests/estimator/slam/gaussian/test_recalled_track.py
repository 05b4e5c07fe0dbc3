"""Places passed: held against a Kalman filter that has them all in its state."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.gaussian.recalled_track import Move, RecalledTrack, came_from
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.motion import Motion, predict_by_odometry, predict_motion
from estimator.slam.models.state_vector import Layout

LAYOUT = Layout(1, 1)
N = LAYOUT.size
STEP_S = 0.8
DRIVING = Motion(acceleration_variance=0.2).driving(STEP_S)
ODOMETRY = np.array([0.5, 0.1]), 0.2, np.diag([0.01, 0.02, 0.003])


def gaussian(mean, covariance, weight=0.0):
    """One hypothesis that has its anchor and its wall."""
    return Hypotheses(
        np.array([weight]),
        mean[None].copy(),
        covariance[None].copy(),
        np.ones((1, 1), dtype=bool),
        np.ones((1, 1), dtype=bool),
        np.ones((1, 1, LAYOUT.features)),
        np.zeros((1, 1), dtype=np.int64),
    )


def some_gaussian(rng):
    """Errors that all depend on each other."""
    root = 0.3 * rng.normal(size=(N, N))
    return rng.normal(size=N), root @ root.T


def measured(rng, mean, covariance, rows):
    """A linear measurement of ``rows`` of the state, taken exactly; mean and covariance of any size."""
    h = np.zeros((2, mean.size))
    h[:, :rows] = rng.normal(size=(2, rows))
    s = h @ covariance @ h.T + 0.05 * np.eye(2)
    gain = np.linalg.solve(s, h @ covariance).T
    mean = mean + gain @ (h @ rng.normal(size=mean.size))
    return mean, covariance - gain @ s @ gain.T


@pytest.mark.parametrize("kind", ["straight", "turned", "odometry"])
def test_places_are_those_of_a_filter_that_keeps_them_in_its_state(kind):
    """Means, covariances and what they have in common with the present state, over five epochs."""
    rng = np.random.default_rng(7)
    mean, covariance = some_gaussian(rng)
    recalled = RecalledTrack.empty(N).with_place(mean, covariance)
    wide = np.concatenate([np.eye(N), np.eye(N)[:2]])
    clone, spread = wide @ mean, wide @ covariance @ wide.T
    for _ in range(5):
        if kind == "turned":
            speed = slice(2, 4)
            clone[speed], spread[speed], spread[:, speed] = 0.0, 0.0, 0.0
            spread[speed, speed] = 0.3 * np.eye(2)
        if kind == "odometry":
            predict_by_odometry(clone, spread, STEP_S, *ODOMETRY)
        else:
            predict_motion(clone, spread, DRIVING)
        predicted = gaussian(clone[:N], spread[:N, :N])
        clone, spread = measured(rng, clone, spread, N)
        corrected = gaussian(clone[:N], spread[:N, :N])
        move = Move(STEP_S, DRIVING, kind == "odometry", 0 if kind == "turned" else 1)
        recalled = recalled.after(LAYOUT, predicted, corrected, move, 1e6)
        np.testing.assert_allclose(recalled.position_m[0], clone[N:], atol=1e-6)
        np.testing.assert_allclose(recalled.covariance_m2[0], spread[N:, N:], atol=1e-6)
        np.testing.assert_allclose(recalled.with_state[0], spread[N:, :N], atol=1e-6)


def test_an_agent_found_elsewhere_tells_nothing_of_the_past():
    """Its place does not come from where it was thought to be."""
    rng = np.random.default_rng(8)
    mean, covariance = some_gaussian(rng)
    recalled = RecalledTrack.empty(N).with_place(mean, covariance)
    away = mean.copy()
    away[:2] += 100.0
    after = recalled.after(
        LAYOUT, gaussian(mean, covariance), gaussian(away, covariance), Move(STEP_S, DRIVING, False, 1), 4.0
    )
    np.testing.assert_array_equal(after.position_m, recalled.position_m)
    assert not after.with_state.any()


def test_a_position_came_from_the_likeliest_prediction():
    """Nearness and weight count."""
    rng = np.random.default_rng(9)
    mean, covariance = some_gaussian(rng)
    other = mean.copy()
    other[0] += 3.0
    both = gaussian(mean, covariance, np.log(0.5)).joined(gaussian(other, covariance, np.log(0.5)))
    assert came_from(both, other[:2], covariance[:2, :2]) == (1, 0.0)
    sure = both._replace(log_weight=np.log([1.0 - 1e-12, 1e-12]))
    assert came_from(sure, 0.5 * (mean + other)[:2], covariance[:2, :2])[0] == 0


def test_every_other_place_is_kept_and_the_last():
    """So the whole track is covered, its latest end included."""
    rng = np.random.default_rng(10)
    recalled = RecalledTrack.empty(N)
    for _ in range(6):
        recalled = recalled.with_place(*some_gaussian(rng))
    kept = recalled.every_other()
    np.testing.assert_array_equal(kept.position_m, recalled.position_m[1::2])
    assert kept.with_state.shape == (3, 2, N)


def test_coordinates_tied_to_the_position_are_tied_to_the_past():
    """An anchor that stands a known way off the agent shares the past's part in the agent's error."""
    rng = np.random.default_rng(11)
    recalled = RecalledTrack.empty(N).with_place(*some_gaussian(rng))
    tied = recalled.moved(LAYOUT.anchor_xy(0), np.eye(2))
    np.testing.assert_array_equal(tied.with_state[:, :, LAYOUT.anchor_xy(0)], recalled.with_state[:, :, :2])
