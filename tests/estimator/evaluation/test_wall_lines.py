"""Walls as lines: their points, what was seen of them, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from estimator.evaluation.wall_lines import line_points, line_std, seen_span
from estimator.geometry import mirror
from estimator.result import SlamResult

Make = Callable[..., SlamResult]


def test_points_of_a_wall_are_as_far_from_rp_as_from_its_image() -> None:
    """Every point of the line is its own mirror image."""
    vrp = np.array([6.0, -8.0])
    points = line_points(vrp, [-30.0, 0.0, 12.5])
    np.testing.assert_allclose(mirror(points, vrp), points, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), np.linalg.norm(points - vrp, axis=1))
    np.testing.assert_allclose(np.diff(np.linalg.norm(points - 0.5 * vrp, axis=1)), [-30.0, 12.5])


def test_spread_of_a_line_is_that_of_drawn_vrps() -> None:
    """The first-order formula equals the spread of lines of VRPs drawn from the covariance."""
    rng = np.random.default_rng(1)
    vrp, covariance = np.array([20.0, 5.0]), np.array([[0.02, 0.01], [0.01, 0.05]])
    along = np.array([-25.0, 0.0, 3.0, 40.0])
    draws = 20_000
    drawn = rng.multivariate_normal(vrp, covariance, draws)
    points = line_points(vrp, along)
    normals = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    heights = normals @ points.T - 0.5 * np.linalg.norm(drawn, axis=1)[:, None]
    tolerance = 4.0 / np.sqrt(2.0 * draws) + 0.01  # Monte Carlo, and the second order
    np.testing.assert_allclose(line_std(vrp, covariance, along), heights.std(axis=0), rtol=tolerance)


@pytest.mark.parametrize("wall", [0, 1, 2, 3])
def test_the_seen_piece_holds_the_true_reflection_points(
    make_result: Make, truth: xr.Dataset, wall: int
) -> None:
    """Reflection points of the true geometry, found by sampling the shortest way, span the piece."""
    result = make_result()
    vrp = result.wall_mean_m[-1, wall]
    along = np.linspace(-40.0, 40.0, 16_001)
    points = line_points(vrp, along)
    best = [
        along[np.argmin(np.linalg.norm(points - anchor, axis=1) + np.linalg.norm(points - agent, axis=1))]
        for anchor in result.anchor_mean_m[-1]
        for agent in result.agent_mean[:, :2]
    ]
    assert seen_span(result, wall) == pytest.approx((min(best), max(best)), abs=0.01)


def test_no_wall_where_the_agent_walked_through(make_result: Make) -> None:
    """Reflection points near the place where the track crosses the line do not count."""
    result = make_result()
    track = result.agent_mean[:, :2]
    means = result.wall_mean_m.copy()
    means[:, 0] = [2.0 * track[20, 0] + 1e-6, 0.0]  # the line x = track[20, 0], crossed after epoch 19
    crossed = make_result(wall_mean_m=means)
    place = track[19, 1]
    low, high = seen_span(crossed, 0, opening_m=0.0)
    assert min(abs(low - place), abs(high - place)) < 0.7
    low, high = seen_span(crossed, 0, opening_m=1.0)
    assert min(abs(low - place), abs(high - place)) > 1.0


def test_a_wall_that_only_the_echo_saw(make_result: Make) -> None:
    """Without located anchors a short piece about the foot of the perpendicular is left."""
    nobody = make_result(anchor_valid=np.zeros((40, 2), dtype=bool))
    low, high = seen_span(nobody, 0)
    assert low == -high < 0.0
