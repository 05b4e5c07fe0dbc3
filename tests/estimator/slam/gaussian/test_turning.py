"""Walls go along circles round anchors: as in a filter in polar coordinates, and honest."""

from __future__ import annotations

import numpy as np
import pytest
from estimator.slam.features import predict_paths
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.turning import turned
from estimator.slam.layout import Layout
from scipy.linalg import block_diag

LAYOUT = Layout(2, 2)
ANCHOR, WALL = LAYOUT.anchor_xy(0), LAYOUT.wall(1)
FIRST, BOTH, NONE = (np.array([each]) for each in ([True, False], [True, True], [False, False]))


def state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A mean with anchors at (60, -10) and (20, 40), walls (-20, 0) and (140, 5), and a covariance."""
    mean = np.zeros(LAYOUT.size)
    mean[LAYOUT.anchor_xy(0)], mean[LAYOUT.anchor_xy(1)] = (60.0, -10.0), (20.0, 40.0)
    mean[LAYOUT.wall(0)], mean[WALL] = (-20.0, 0.0), (140.0, 5.0)
    root = rng.normal(size=(LAYOUT.size, LAYOUT.size))
    return mean, root @ root.T


def chart(mean: np.ndarray) -> np.ndarray:
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
    mean, after = turned(before[None], (before + shift)[None], covariance[None], FIRST, LAYOUT)
    arm = before[WALL] - before[ANCHOR]
    distance, arc = (chart(before) @ shift)[WALL]  # the same linear update, in the chart's coordinates
    bearing = np.arctan2(arm[1], arm[0]) + arc / np.linalg.norm(arm)
    expected = before + shift
    length = np.linalg.norm(arm) + distance
    expected[WALL] = expected[ANCHOR] + length * np.array([np.cos(bearing), np.sin(bearing)])
    assert np.allclose(mean[0], expected, atol=1e-10)
    errors = chart(before) @ covariance @ chart(before).T
    assert np.allclose(chart(mean[0]) @ after[0] @ chart(mean[0]).T, errors, atol=1e-9)


def test_the_anchor_that_knows_best():
    """A wall goes round the anchor that its distance is known best from, whichever is heard."""
    before, moved = state(np.random.default_rng(5))[0], state(np.random.default_rng(5))[0]
    moved[WALL] += (3.0, -8.0)
    for k in range(2):
        arm = moved[WALL] - moved[LAYOUT.anchor_xy(k)]
        across = np.array([-arm[1], arm[0]]) / np.linalg.norm(arm)
        covariance = np.zeros((LAYOUT.size, LAYOUT.size))
        covariance[WALL, WALL] = 4.0 * np.outer(across, across) + 1e-4 * np.eye(2)
        mean = turned(before[None], moved[None], covariance[None], BOTH, LAYOUT)[0][0]
        expected = turned(before[None], moved[None], covariance[None], np.array([[k == 0, k == 1]]), LAYOUT)
        assert np.array_equal(mean, expected[0][0])


def test_what_does_not_turn():
    """The gauge's wall, walls where no anchor is located, that did not move, or that moved by a large arc."""
    before, covariance = state(np.random.default_rng(3))
    moved = before.copy()
    moved[WALL] += (0.0, 4.0)
    mean, after = turned(before[None], moved[None], covariance[None], NONE, LAYOUT)
    assert np.array_equal(mean[0], moved)
    assert np.allclose(after[0], covariance)
    mean, after = turned(before[None], before[None], covariance[None], FIRST, LAYOUT)
    assert np.array_equal(mean[0], before)
    assert np.array_equal(after[0], covariance)
    moved[WALL] = before[WALL] + (0.0, 40.0)
    mean, after = turned(before[None], moved[None], covariance[None], FIRST, LAYOUT)
    assert np.array_equal(mean[0], moved)
    assert np.array_equal(after[0], covariance)
    moved[WALL] = before[WALL]
    moved[LAYOUT.wall(0)] += (1.0, 0.0)
    mean, _ = turned(before[None], moved[None], covariance[None], BOTH, LAYOUT)
    assert np.allclose(mean[0], moved)


@pytest.mark.parametrize("turning", [True, False])
def test_honest_about_a_far_wall(turning: bool):
    """Sixty paths over one anchor, then sixty over another: NEES within its band, and not without turning."""
    runs, rng, std = 400, np.random.default_rng(4), 0.1
    truth = state(rng)[0]
    spread = block_diag(np.zeros((WALL.start, WALL.start)), 4.0 * np.eye(2))
    mean = np.tile(truth, (runs, 1))
    mean[:, WALL] += 2.0 * rng.normal(size=(runs, 2))
    covariance = np.tile(spread, (runs, 1, 1))
    for anchor in np.repeat([0, 1], 60):
        heard = predict_paths(truth[None], LAYOUT).length_m[:, anchor, [2]] + std * rng.normal(size=(runs, 1))
        expected = predict_paths(mean, LAYOUT)
        before = mean
        mean, covariance, _ = kalman(
            mean,
            covariance,
            expected.jacobian[:, anchor, [2]],
            heard - expected.length_m[:, anchor, [2]],
            np.full((runs, 1), std**2),
        )
        if turning:
            mean, covariance = turned(before, mean, covariance, np.repeat(BOTH, runs, axis=0), LAYOUT)
    error = mean[:, WALL] - truth[WALL]
    nees = 0.5 * np.einsum("ri,rij,rj->r", error, np.linalg.inv(covariance[:, WALL, WALL]), error)
    band = 4.0 / np.sqrt(runs)  # the standard deviation of a chi-squared per dimension, of two, is 1
    assert (abs(nees.mean() - 1.0) < band) == turning
