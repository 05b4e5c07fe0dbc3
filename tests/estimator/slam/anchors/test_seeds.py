"""Seeds: where circles meet, which are kept, and what they cost."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.anchors.cells import Cells, SearchLimits, known_cell
from estimator.slam.anchors.seeds import apart, choose_seeds, paired
from tests.estimator.slam.anchors.scenes import ANCHOR, observed, scene

LIMITS = SearchLimits(20_000, 80_000, 5, 12, 1000, 60, 600)


def seeds(given, cells=None, limits=LIMITS):
    """The chosen seeds (S, 2) and their cells."""
    cells = known_cell(0.0) if cells is None else cells
    x, y, cell = choose_seeds(given.circles, given.seen, cells, given.vrp_m, given.model, limits, 0.7, 1.0)
    return np.stack([x, y], axis=1), cell


def test_the_place_where_all_circles_meet_is_a_seed():
    """Were the true place no seed, no refinement would find it."""
    points, _ = seeds(scene(observed([(0.0, 0.0)], extra=(33.3, 71.0))))
    assert np.linalg.norm(points - ANCHOR, axis=1).min() < 0.05
    assert len(points) <= LIMITS.refined


def test_only_the_right_clock_bias_and_height_give_the_place():
    """Circles of a wrong radius meet where the anchor is not."""
    given = scene(observed([(0.0, 0.0)], bias=3.0, height2=25.0))
    cells = Cells(np.array([0.0, 3.0, 3.0]), np.array([25.0, 0.0, 25.0]), np.zeros(3), np.zeros(3))
    points, cell = seeds(given, cells)
    gap = np.linalg.norm(points - ANCHOR, axis=1)
    assert cell[np.argmin(gap)] == 2
    assert gap.min() < 1e-6
    assert gap[cell < 2].min() > 0.05


def test_seeds_of_one_cell_are_apart_and_those_of_two_need_not_be():
    """Near-copies would take the room of other places; another clock is another place."""
    given = scene(observed([(0.0, 0.0)], extra=(33.3, 71.0)))
    points, cell = seeds(given, Cells(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2), np.zeros(2)))
    for own in (0, 1):
        mine = points[cell == own]
        gap = np.linalg.norm(mine[:, None] - mine, axis=-1) + 9.0 * np.eye(len(mine))
        assert gap.min() > 0.7


def test_a_likelier_cell_comes_first():
    """The prior of clock and height decides between places that fit equally."""
    given = scene(observed([(0.0, 0.0)]))
    _, cell = seeds(given, Cells(np.zeros(2), np.zeros(2), np.zeros(2), np.array([-5.0, 0.0])))
    assert cell[0] == 1


@pytest.mark.parametrize("paths", [0, 1, 2, 10, 50, 200])
@pytest.mark.parametrize("most", [1, 300, 20_000])
def test_pairs_stay_within_their_bound(paths, most):
    """Two hundred paths and twenty walls would make eight million pairs."""
    given = scene(observed([(0.0, 0.0)], extra=tuple(np.linspace(20.0, 150.0, max(paths - 5, 0)))))
    seen = given.seen._replace(paths=np.minimum(given.seen.paths, paths))
    centre, path = paired(given.circles, seen, most, LIMITS)
    pairs = len(centre) * (len(centre) - 1) // 2 * len(path) * (len(path) - 1)
    assert pairs <= max(most, 20)  # two paths on five circles at the least
    assert len(path) <= paths
    if most == 20_000 and paths <= 40:
        assert (len(centre), len(path)) == (5, paths)


def test_the_best_known_paths_and_the_nearest_walls_are_paired():
    """Where not all can be paired, the longest images and the worst lengths have the least to tell."""
    given = scene(observed([(0.0, 0.0)], extra=tuple(np.linspace(20.0, 150.0, 95))))
    variance = np.where(np.arange(100) % 4 == 0, 0.01, 0.04)[None]
    seen = given.seen._replace(length_variance_m2=variance)
    centre, path = paired(given.circles, seen, 3_000, LIMITS._replace(paired_paths=20, paired_circles=3))
    assert np.all(variance[0, path] == 0.01)
    size = np.hypot(given.circles.x[0, :5], given.circles.y[0, :5])
    assert size[centre].max() < np.delete(size, centre).min()


def test_fewer_are_scored_and_refined_if_so_told():
    """The bounds of a search bound it."""
    given = scene(observed([(0.0, 0.0)], extra=(33.3, 71.0)))
    points, _ = seeds(given, limits=LIMITS._replace(scored=7, refined=5))
    assert len(points) <= 5
    points, cell = seeds(
        given,
        Cells(np.arange(4.0), np.zeros(4), np.zeros(4), np.zeros(4)),
        LIMITS._replace(refined=5, refined_in_all=12),
    )
    assert len(points) <= 12
    assert np.bincount(cell).max() <= 5


def test_points_apart_are_those_a_plain_loop_keeps():
    """The greedy choice, written plainly."""
    rng = np.random.default_rng(3)
    point, group = rng.uniform(0.0, 4.0, (200, 3)), rng.integers(0, 3, 200)
    order = rng.permutation(200)
    kept = []
    for s in order.tolist():
        if (
            all(np.linalg.norm(point[s] - point[t]) > 0.8 for t in kept)
            and sum(group[t] == group[s] for t in kept) < 6
        ):
            kept.append(s)
    assert apart(point, order, 0.8, group, 6, 99).tolist() == kept
    assert apart(point, order, 0.8, group, 6, 4).tolist() == kept[:4]
    none = np.zeros(0, dtype=np.int64)
    assert apart(np.zeros((0, 3)), none, 0.8, none, 6, 4).size == 0
