"""Limits of buildings: odometry by its closed form, flashes on finite walls, walls in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.errors import ConfigurationError, InputError
from estimator.slam.bounds.posterior import posterior_bounds
from estimator.slam.bounds.scenario import Scenario, Sensing

NOTHING = {"range_std_m": 1e7, "order": 0, "anchors_known": True, "walls_known": True}


@pytest.fixture(scope="module")
def room():
    """A room of 10 m by 6 m whose south wall has a door, and a screen in it; an agent that turns twice."""
    walls = np.array(
        [
            [[0, 0], [4, 0]],
            [[5, 0], [10, 0]],
            [[10, 0], [10, 6]],
            [[10, 6], [0, 6]],
            [[0, 6], [0, 0]],
            [[6, 4], [8, 4]],
        ],
        dtype=float,
    )
    track = np.array([[2, 2], [3, 2], [4, 2], [4.5, 2], [4.5, 3], [4.5, 4], [5.5, 4.5], [7, 3]], dtype=float)
    return Scenario(walls[:, 0], walls[:, 1], np.array([[1.0, 5.0]]), track)


def test_dead_reckoning_has_its_closed_form(room):
    """With nothing else measured, displacement errors add up, and a turn's error swings what follows."""
    share, turn = 0.05, 0.02
    found = posterior_bounds(room, Sensing(**NOTHING, odometry=(share, turn))).position_covariance_m2
    track = room.track_m
    for t in range(1, len(track)):
        ways = np.linalg.norm(np.diff(track[: t + 1], axis=0), axis=1)
        expected = share**2 * np.sum(ways**2) * np.eye(2)
        for j in range(1, t):  # the turn measured at epoch j
            x, y = track[t] - track[j]
            expected += turn**2 * np.outer([-y, x], [-y, x])
        np.testing.assert_allclose(found[t], expected, rtol=1e-6, atol=1e-9)


def test_odometry_bounds_no_smoother(room):
    """The chain of the batch has no direction of the body; asked for, it is refused."""
    with pytest.raises(ConfigurationError, match="expected 'recursive' with odometry"):
        posterior_bounds(room, Sensing(odometry=(0.05, 0.02)), "batch")


def test_walls_flash_where_the_perpendicular_meets_them(room):
    """Not beside their ends, through the door, or behind a screen."""
    flashing = room.flashing()
    assert flashing[0].tolist() == [True, False, True, True, True, False]
    assert flashing[3].tolist() == [False, False, True, True, True, False]  # before the door
    assert flashing[7].tolist() == [False, True, True, False, True, True]  # the screen hides the north


def test_walls_in_one_line_are_one_unknown(room):
    """A flash of one part of the south wall tells the other; as walls of their own it does not."""
    assert room.lines.tolist() == [0, 0, 2, 3, 4, 5]
    sensing = {"sensed": {0: 0.01, 3: 0.01}, "order": 1, "sweep_every": 1, "flashes": True}
    shared = posterior_bounds(room, Sensing(**sensing, lines_shared=True)).wall_covariance_m2
    apart = posterior_bounds(room, Sensing(**sensing)).wall_covariance_m2
    np.testing.assert_allclose(shared[:, 0], shared[:, 1], atol=1e-9)
    assert np.trace(apart[1, 1]) > 1e3
    assert np.trace(shared[1, 1]) < 0.1


def test_how_near_walls_are_of_one_line_is_said(room):
    """Ends rounded by more than the setting make lines of their own; no width at all is refused."""
    moved = room.end_m + [[0.0, 0.0], [0.0, 0.05], *[[0.0, 0.0]] * 4]
    assert replace(room, end_m=moved).lines.tolist() == [0, 1, 2, 3, 4, 5]
    assert replace(room, end_m=moved, same_line_m=1.0).lines[:2].tolist() == [0, 0]
    with pytest.raises(InputError, match=r"same_line_m: expected a positive number, got 0\.0"):
        replace(room, same_line_m=0.0)


def test_a_common_echo_bias_is_no_noise(room):
    """It moves walls, by twice itself along their normals, and not the agent, whose start is the origin."""
    sensing = {"order": 0, "sweep_every": 1, "flashes": True, "sensed": dict.fromkeys((0, 2, 3, 4), 1e-4)}
    exact = posterior_bounds(room, Sensing(**sensing))
    biased = posterior_bounds(room, Sensing(**sensing, echo_bias_std_m=0.04))
    np.testing.assert_allclose(biased.position_rmse_m, exact.position_rmse_m, rtol=1e-6)
    more = biased.wall_covariance_m2[-1, 2] - exact.wall_covariance_m2[-1, 2]
    np.testing.assert_allclose(more, np.diag([(2 * 0.04) ** 2, 0.0]), atol=1e-6)


def test_what_is_out_of_range_is_refused():
    """Odometry without noise, a bias that is no number."""
    with pytest.raises(
        ConfigurationError, match=r"Sensing.odometry: expected two positive numbers, got \(0.0, 1.0\)"
    ):
        Sensing(odometry=(0.0, 1.0))
    with pytest.raises(ConfigurationError, match=r"Sensing.echo_bias_std_m: expected 0 or a positive number"):
        Sensing(echo_bias_std_m=np.nan)
