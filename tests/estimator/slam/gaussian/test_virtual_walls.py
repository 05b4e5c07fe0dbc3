"""Walls that virtual anchors imply: each once, as the anchor that knows it best has it."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.slam import GaussianConfig, start
from estimator.slam.gaussian.slots import open_slot
from estimator.slam.gaussian.virtual_walls import virtual_walls
from estimator.slam.models.visibility import Visibility

ANCHORS = np.array([[4.0, 1.0], [-3.0, 2.0]])
WALL = np.array([2.0, 12.0])  # VRP


def some_state(spread=(0.01, 0.04)):
    """Both anchors' images in one wall, known to different variances along distance and bearing."""
    state = start([], ("a", "b"), 6e9, GaussianConfig(), ANCHORS, shared=False)
    for k, anchor in enumerate(ANCHORS):
        state, slot = open_slot(state, Visibility())
        image = mirror(anchor, WALL)
        columns = state.layout.wall(slot)
        state.hypotheses.mean[0, columns] = np.linalg.norm(image), np.arctan2(image[1], image[0]), 0.0, 0.0
        free = slice(columns.start, columns.start + 2)
        state.hypotheses.covariance[0, free, free] = spread[k] * np.diag([1.0, 0.01])
        state.hypotheses.present[0, slot] = True
        state.slots.wall_id[slot], state.slots.owner[slot], state.slots.confirmed[slot] = 5 - k, k, True
    return state


def test_a_wall_of_two_anchors_is_told_once():
    """Under its first identity, with the better covariance."""
    walls = virtual_walls(some_state(), np.ones(1), 1.0)
    assert [wall.wall_id for wall in walls] == [4]
    np.testing.assert_allclose(walls[0].mean_m, WALL, atol=1e-9)
    assert walls[0].existence == 1.0
    better = virtual_walls(some_state((0.04, 0.01)), np.ones(1), 1.0)[0]
    assert np.trace(better.covariance_m2) != pytest.approx(np.trace(walls[0].covariance_m2))
    alone = some_state()
    alone.slots.confirmed[1] = False
    only = virtual_walls(alone, np.ones(1), 1.0)
    np.testing.assert_allclose(only[0].covariance_m2, walls[0].covariance_m2)
    assert only[0].wall_id == 5


def test_its_covariance_is_that_of_draws():
    """Distances and bearings drawn, their walls computed."""
    state = some_state()
    state.slots.confirmed[1] = False
    wall = virtual_walls(state, np.ones(1), 1.0)[0]
    columns = state.layout.wall(0)
    r, phi = state.hypotheses.mean[0, columns][:2]
    rng = np.random.default_rng(1)
    r, phi = r + 0.1 * rng.normal(size=100_000), phi + 0.01 * rng.normal(size=100_000)
    image = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1)
    chord = image - ANCHORS[0]
    rise = np.sum(image**2, axis=1) - ANCHORS[0] @ ANCHORS[0]
    vrp = (rise / np.sum(chord**2, axis=1))[:, None] * chord
    np.testing.assert_allclose(np.cov(vrp.T), wall.covariance_m2, atol=0.05 * np.trace(wall.covariance_m2))


def test_hypotheses_that_have_it_elsewhere_do_not_count():
    """Its existence is the weight of those that agree with the likeliest; of unfound ones nothing is told."""
    state = some_state()
    other = state.hypotheses.take([0])
    other.mean[0, state.layout.wall(0).start + 1] += 1.0
    both = state.hypotheses.joined(other)
    state = state.but(hypotheses=both)
    state.slots.confirmed[1] = False
    walls = virtual_walls(state, np.array([0.8, 0.2]), 1.0)
    assert walls[0].existence == pytest.approx(0.8)
    np.testing.assert_allclose(walls[0].mean_m, WALL, atol=1e-9)
