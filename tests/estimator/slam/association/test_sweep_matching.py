"""Flashes and walls: known ones, new ones, double bounces, and what is in doubt."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from estimator.slam.association import sweep_matching
from estimator.slam.association.sweep_matching import are_double_bounces, double_bounce
from estimator.slam.gaussian.sweep_update import SweepMatching
from estimator.slam.models.features import mirror
from estimator.slam.models.state_vector import ECHO_BIAS, Layout
from estimator.slam.models.sweeps import predict_flashes

LAYOUT = Layout(1, 3)
MODEL = SweepMatching().compiled(0.0)
NOISE = np.diag([0.02**2, 0.02**2])
NOBODY = np.full(2, -1)


def scene():
    """Three walls, two of them in a corner of 80 degrees, and an agent known to 5 cm."""
    mean = np.zeros(LAYOUT.size + 1)
    mean[:2] = 1.0, 0.5
    mean[LAYOUT.anchor(0)] = 20.0, 5.0, 1.0, 0.0
    mean[LAYOUT.wall(0)] = 12.0, 0.0
    angle = np.deg2rad(100.0)
    mean[LAYOUT.wall(1)] = 16.0 * np.cos(angle), 16.0 * np.sin(angle)
    mean[LAYOUT.wall(2)] = -10.0, 1.0
    covariance = np.zeros((mean.size, mean.size))
    covariance[0, 0] = covariance[1, 1] = 0.05**2
    for i in range(3):
        covariance[LAYOUT.wall(i), LAYOUT.wall(i)] = 0.02**2 * np.eye(2)
    return mean, covariance


def matched(mean, covariance, seen, forced=NOBODY):
    """What flashes are taken for, and the log density, the margin and the least sure of them."""
    slot, residual = np.empty(len(seen), dtype=np.int64), np.empty((2, 2))
    noise = np.tile(NOISE, (len(seen), 1, 1))
    told = sweep_matching.match_flashes(
        LAYOUT, mean, covariance, np.ones(3, dtype=bool), seen, noise, 0.0, MODEL, forced, slot, residual
    )
    return slot, residual, told


def test_flashes_of_known_walls_are_theirs():
    """In whatever order they come; the agent is known better afterwards."""
    mean, covariance = scene()
    seen = predict_flashes(mean[:-1], LAYOUT)[0][[2, 0, 1]]
    slot, residual, _ = matched(mean, covariance, seen)
    assert slot.tolist() == [2, 0, 1]
    assert np.all(residual[:, 0] < 1e-6)
    assert np.all((residual[:, 1] > 0.0) & (residual[:, 1] < 3.0))
    assert covariance[0, 0] < 0.02**2


def test_a_flash_far_from_all_walls_is_a_new_one():
    """Unless its range and direction are those of a double bounce over two of them."""
    mean, covariance = scene()
    known = predict_flashes(mean[:-1], LAYOUT)[0]
    slot, _, _ = matched(mean.copy(), covariance.copy(), np.concatenate([known, [[0.0, -9.0]]]))
    assert slot.tolist() == [0, 1, 2, -1]
    first, second = mean[LAYOUT.wall(0)], mean[LAYOUT.wall(1)]
    there = np.array(mirror(*mirror(*mean[:2], *first), *second)) - mean[:2]
    back = np.array(mirror(*mirror(*mean[:2], *second), *first)) - mean[:2]
    middle = there / np.linalg.norm(there) + back / np.linalg.norm(back)
    ghost = np.linalg.norm(there) * middle / np.linalg.norm(middle)
    slot, _, _ = matched(mean, covariance, np.concatenate([known, ghost[None]]))
    assert slot.tolist() == [0, 1, 2, -2]


def test_the_rival_of_a_doubtful_match_is_told_and_can_be_forced():
    """Two walls half a metre apart, the agent known to as much: the flash may be either's."""
    mean, covariance = scene()
    mean[LAYOUT.wall(2)] = mean[LAYOUT.wall(0)] + [0.6, 0.0]
    covariance[0, 0] = covariance[1, 1] = 0.3**2
    seen = predict_flashes(mean[:-1], LAYOUT)[0][:1]
    slot, _, (density, margin, flash, wall) = matched(mean.copy(), covariance.copy(), seen)
    assert slot.tolist() == [0]
    assert (flash, wall) == (0, 2)
    assert 0.0 < margin < 3.0
    other, _, (less, _, none, _) = matched(mean, covariance, seen, np.array([0, 2]))
    assert other.tolist() == [2]
    assert none == -1
    assert density - less == pytest.approx(margin, abs=0.3)


def test_a_common_bias_of_all_ranges_is_learnt():
    """Two walls face to face tell the bias of the front end from the agent's place."""
    mean, covariance = scene()
    covariance[ECHO_BIAS, ECHO_BIAS] = 0.04**2
    mean[LAYOUT.wall(2)] = -10.0, 0.0
    truth = mean.copy()
    truth[ECHO_BIAS] = 0.05
    seen = predict_flashes(truth[:-1], LAYOUT)[0]
    for i in range(3):
        covariance[LAYOUT.wall(i), LAYOUT.wall(i)] = 0.002**2 * np.eye(2)
    matched(mean, covariance, seen)
    assert mean[ECHO_BIAS] == pytest.approx(0.05, abs=3.0 * np.sqrt(covariance[ECHO_BIAS, ECHO_BIAS]))
    assert covariance[ECHO_BIAS, ECHO_BIAS] < 0.02**2


def test_the_heading_that_fits_a_sweep_is_found():
    """Whatever it is."""
    mean, _ = scene()
    flash = predict_flashes(mean[:-1], LAYOUT)[0]
    for turn in (0.4, -2.0, 3.0):
        c, s = np.cos(turn), np.sin(turn)
        seen = flash @ np.array([[c, s], [-s, c]])
        found = sweep_matching.heading_of(
            LAYOUT, mean[:-1], np.ones(3, dtype=bool), seen, np.tile(NOISE, (3, 1, 1)), 0.5
        )
        assert found == pytest.approx(turn, abs=1e-6)


def test_a_double_bounce_there_and_back():
    """Over two walls square to each other the corner throws back: its distance and direction."""
    own, middle, half = double_bounce(1.0, 2.0, 8.0, 0.0, 0.0, 12.0)  # walls x = 4 and y = 6
    assert own == pytest.approx(5.0)
    assert middle == pytest.approx(np.arctan2(4.0, 3.0))
    assert half == pytest.approx(0.0, abs=1e-12)


def test_a_double_bounce_is_as_long_as_its_legs():
    """Agent, one wall, the other, agent: the shortest such way, found by search, is twice the range."""
    agent, vrps = np.array([0.5, -0.3]), np.array([[8.0, 0.0], [-3.0, 9.0]])

    def on(wall, along):
        square = vrps[wall] @ vrps[wall]
        return 0.5 * vrps[wall] + along * np.array([-vrps[wall, 1], vrps[wall, 0]]) / np.sqrt(square)

    def way(at):
        first, second = on(0, at[0]), on(1, at[1])
        return sum(np.linalg.norm(leg) for leg in (first - agent, second - first, agent - second))

    shortest = minimize(way, [1.0, -1.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    own, middle, half = double_bounce(*agent, *vrps[0], *vrps[1])
    assert 2.0 * own == pytest.approx(shortest.fun, abs=1e-6)
    ends = [np.arctan2(*(on(wall, shortest.x[wall]) - agent)[::-1]) for wall in range(2)]
    assert sorted(ends) == pytest.approx([middle - half, middle + half], abs=1e-3)


def test_a_double_bounce_is_one_pair_seen_from_all_places():
    """Two flashes that two pairs explain, one each, are no corner."""
    mean = np.zeros(LAYOUT.size)
    walls = np.array([[10.0, 0.0], [0.0, 12.0], [-8.0, 0.0]])
    mean[LAYOUT.walls] = walls.ravel()
    corner, other = np.array([5.0, 6.0]), np.array([-4.0, 6.0])

    def seen(corners):
        places = np.array([[1.0, 1.0], [2.0, -3.0]])
        return np.stack([places, 2.0 * np.array(corners) - places], axis=1)

    present = np.ones(3, dtype=bool)
    assert are_double_bounces(LAYOUT, mean, present, seen([corner, corner]), 0.1, 0.1)
    assert are_double_bounces(LAYOUT, mean, present, seen([other, other]), 0.1, 0.1)
    assert not are_double_bounces(LAYOUT, mean, present, seen([corner, other]), 0.1, 0.1)
    assert not are_double_bounces(
        LAYOUT, mean, np.array([True, False, True]), seen([corner, corner]), 0.1, 0.1
    )
