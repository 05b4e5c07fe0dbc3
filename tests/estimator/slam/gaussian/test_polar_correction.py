"""Walls go along circles round anchors: as in a filter in polar coordinates, and honest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimator.slam.gaussian.polar_correction import correct_along_circles
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import Layout

LAYOUT = Layout(2, 2)
ANCHOR, WALL = LAYOUT.anchor_xy(0), LAYOUT.wall(1)
FIRST, BOTH, NONE = (np.array(each) for each in ([True, False], [True, True], [False, False]))


def state(rng):
    """A mean with anchors at (60, -10) and (20, 40), walls (-20, 0) and (140, 5), and a covariance."""
    mean = np.zeros(LAYOUT.size)
    mean[LAYOUT.anchor_xy(0)], mean[LAYOUT.anchor_xy(1)] = (60.0, -10.0), (20.0, 40.0)
    mean[LAYOUT.wall(0)], mean[WALL] = (-20.0, 0.0), (140.0, 5.0)
    root = rng.normal(size=(LAYOUT.size, LAYOUT.size))
    return mean, root @ root.T


def turned(before, moved, covariance, located, most_turn=0.3):
    """A corrected Gaussian, its walls moved along circles."""
    mean, spread = moved.copy(), covariance.copy()
    correct_along_circles(LAYOUT, before, mean, spread, located, most_turn)
    return mean, spread


def chart(mean):
    """Derivatives (n, n) of the state with the second wall's distance from the first anchor, and its arc."""
    arm = mean[WALL] - mean[ANCHOR]
    along = arm / np.linalg.norm(arm)
    rows = np.stack([along, [-along[1], along[0]]])
    change = np.eye(LAYOUT.size)
    change[WALL, WALL], change[WALL, ANCHOR] = rows, -rows
    return change


def test_a_filter_in_polar_coordinates():
    """Mean and covariance are those of an update that holds distance and arc about the anchor."""
    before, covariance = state(np.random.default_rng(1))
    shift = np.random.default_rng(2).normal(size=LAYOUT.size)
    shift[LAYOUT.wall(0).start + 1] = 0.0
    mean, after = turned(before, before + shift, covariance, FIRST)
    arm = before[WALL] - before[ANCHOR]
    distance, arc = (chart(before) @ shift)[WALL]  # the same linear update, in the chart's coordinates
    bearing = np.arctan2(arm[1], arm[0]) + arc / np.linalg.norm(arm)
    expected = before + shift
    length = np.linalg.norm(arm) + distance
    expected[WALL] = expected[ANCHOR] + length * np.array([np.cos(bearing), np.sin(bearing)])
    assert np.allclose(mean, expected, atol=1e-10)
    errors = chart(before) @ covariance @ chart(before).T
    assert np.allclose(chart(mean) @ after @ chart(mean).T, errors, atol=1e-9)
    assert np.array_equal(after, after.T)


def test_the_anchor_that_knows_best():
    """A wall goes round the anchor that its distance is known best from, whichever is heard."""
    before = state(np.random.default_rng(5))[0]
    moved = before.copy()
    moved[WALL] += (3.0, -8.0)
    for k in range(2):
        arm = moved[WALL] - moved[LAYOUT.anchor_xy(k)]
        across = np.array([-arm[1], arm[0]]) / np.linalg.norm(arm)
        covariance = np.zeros((LAYOUT.size, LAYOUT.size))
        covariance[WALL, WALL] = 4.0 * np.outer(across, across) + 1e-4 * np.eye(2)
        expected = turned(before, moved, covariance, np.array([k == 0, k == 1]))
        assert np.array_equal(turned(before, moved, covariance, BOTH)[0], expected[0])


def test_what_does_not_turn():
    """The gauge's wall, walls where no anchor is located, that did not move, or that moved by a large arc."""
    before, covariance = state(np.random.default_rng(3))
    covariance = 0.5 * (covariance + covariance.T)
    moved = before.copy()
    moved[WALL] += (0.0, 4.0)
    far, gauge = before.copy(), before.copy()
    far[WALL] += (0.0, 40.0)
    gauge[LAYOUT.wall(0)] += (1.0, 0.0)
    for after, located in ((moved, NONE), (before, FIRST), (far, FIRST), (gauge, BOTH)):
        mean, spread = turned(before, after, covariance, located)
        assert np.array_equal(mean, after)
        assert np.allclose(spread, covariance)


@pytest.mark.parametrize("polar", [True, False])
def test_honest_about_a_far_wall(polar):
    """Sixty paths over one anchor, then sixty over another: NEES within its band, and not without turning."""
    runs, rng, std = 400, np.random.default_rng(4), 0.1
    truth = state(rng)[0]
    spread = block_diag(np.zeros((WALL.start, WALL.start)), 4.0 * np.eye(2))
    mean = np.tile(truth, (runs, 1))
    mean[:, WALL] += 2.0 * rng.normal(size=(runs, 2))
    covariance = np.tile(spread, (runs, 1, 1))
    for anchor in np.repeat([0, 1], 60):
        heard = predict_paths(truth[None], LAYOUT).length_m[:, anchor, 2] + std * rng.normal(size=runs)
        expected = predict_paths(mean, LAYOUT)
        h = expected.derivatives(np.full((runs, 2, 1), 2))[:, anchor, 0]
        cross = np.einsum("rij,rj->ri", covariance, h)
        s = np.einsum("ri,ri->r", h, cross) + std**2
        before = mean
        mean = before + cross * ((heard - expected.length_m[:, anchor, 2]) / s)[:, None]
        covariance = covariance - cross[:, :, None] * cross[:, None, :] / s[:, None, None]
        if polar:
            for r in range(runs):
                correct_along_circles(LAYOUT, before[r], mean[r], covariance[r], BOTH, 0.3)
    error = mean[:, WALL] - truth[WALL]
    nees = 0.5 * np.einsum("ri,rij,rj->r", error, np.linalg.inv(covariance[:, WALL, WALL]), error)
    band = 4.0 / np.sqrt(runs)  # the standard deviation of a chi-squared per dimension, of two, is 1
    assert (abs(nees.mean() - 1.0) < band) == polar
