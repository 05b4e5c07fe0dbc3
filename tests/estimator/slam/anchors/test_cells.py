"""What a search tries, and what it may cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.slam.anchors.cells import cells_of, heights_of, limits_of
from tests.estimator.slam.anchors.scenes import SEARCH, observed, scene


def test_a_known_clock_is_one_cell_in_the_plane():
    """What the clock may still be off makes the lengths less certain, and is not searched."""
    cells, variance = cells_of(3.0, 0.5, SEARCH)
    assert [column.tolist() for column in cells] == [[3.0], [0.0], [0.0], [0.0]]
    assert variance == 0.25


def test_an_unknown_clock_is_a_normalised_grid():
    """Priors that do not sum to one would shift the evidence against waiting."""
    cells, variance = cells_of(3.0, 10.0, SEARCH)
    assert np.exp(cells.log_prior).sum() == pytest.approx(1.0, abs=0.01)
    assert np.sum(np.exp(cells.log_prior) * cells.bias_m) == pytest.approx(3.0, abs=0.1)
    assert np.diff(cells.bias_m) == pytest.approx(1.0)
    assert variance == pytest.approx(1.0 / 12.0)


def test_clocks_and_heights_are_tried_together():
    """Every bias with every height, each pair once."""
    cells, _ = cells_of(0.0, 2.0, replace(SEARCH, height_cells=3))
    pairs = set(zip(cells.bias_m.tolist(), cells.height2_m2.tolist(), strict=True))
    assert len(pairs) == len(cells.bias_m) == 3 * len(set(cells.bias_m.tolist()))
    assert np.exp(cells.log_prior).sum() == pytest.approx(1.0, abs=0.01)


def test_the_prior_of_heights_is_exponential():
    """Cells of equal mass per metre would make every second anchor one on a mast."""
    height2, std, log_prior = heights_of(replace(SEARCH, height_cells=8))
    assert np.exp(log_prior).sum() == pytest.approx(1.0)
    mean = np.sum(np.exp(log_prior) * np.sqrt(height2))
    assert 1.5 < mean < 2.5  # 2.5 m, cut off at 6.5 m
    assert np.all(np.diff(height2) > 0.0)
    assert np.all(std > 0.0)


@pytest.mark.parametrize("share", [1, 7, 1000])
def test_all_searches_together_cost_what_one_may(share):
    """Work that each anchor may do on its own would grow with the anchors."""
    circles = scene(observed([(0.0, 0.0)] * 3)).circles
    limits = limits_of(share, 61, circles, SEARCH)
    assert limits.pairs_in_all * 5 * share <= SEARCH.max_pair_circles
    assert limits.scored == 1 or limits.scored * 12 * share <= SEARCH.max_scored_circles
    assert limits.refined_in_all == 1 or limits.refined_in_all * 51 * share <= SEARCH.max_refined_circles
    assert limits.refined == SEARCH.max_refined


def test_a_height_that_is_found_is_known_to_more_than_its_cell():
    """Cells beside it explain the paths nearly as well; in the plane there is nothing to widen."""
    wide = replace(SEARCH, height_cells=8, height_widths=3.0)
    cells, _ = cells_of(0.0, 0.0, wide)
    np.testing.assert_allclose(cells.height2_std_m2, 3.0 * heights_of(wide)[1])
    flat = replace(SEARCH, height_cells=0, height_widths=3.0)
    np.testing.assert_allclose(cells_of(0.0, 0.0, flat)[0].height2_std_m2, heights_of(flat)[1])
