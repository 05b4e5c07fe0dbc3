"""Simulated measurements against their own model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from estimator.errors import ConfigurationError, InputError
from estimator.simulate import SimulationConfig, simulate_epochs, simulate_walls
from estimator.specular import SpecularPaths, specular_paths

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def test_a_square_room_has_the_paths_it_must():
    """In a convex room every wall reflects once; double bounces are the images' images."""
    start, end = SQUARE, np.roll(SQUARE, -1, axis=0)
    paths = specular_paths(start, end, [[2.0, 3.0]], [[7.0, 6.0]], order=2)
    by_walls = dict(zip(paths.walls, range(len(paths.walls)), strict=True))
    assert paths.visible[0, 0, by_walls[()]]
    expected = {(): (5.0, 3.0), (0,): (5.0, 9.0), (1,): (11.0, 3.0), (2,): (5.0, 11.0), (3,): (9.0, 3.0)}
    for walls, offset in expected.items():
        assert paths.visible[0, 0, by_walls[walls]]
        assert paths.length_m[0, 0, by_walls[walls]] == pytest.approx(np.hypot(*offset))
    # opposite walls: 20 m shift; corners: the point reflection, by exactly one of two orders
    assert paths.length_m[0, 0, by_walls[(0, 2)]] == pytest.approx(np.hypot(5.0, 17.0))
    assert paths.visible[0, 0, by_walls[(0, 2)]]
    assert paths.visible[0, 0, by_walls[(0, 1)]] + paths.visible[0, 0, by_walls[(1, 0)]] == 1


def test_walls_block():
    """A screen hides the line of sight and what would pass through it."""
    start = np.array([[0.0, 0.0], [5.0, 2.0]])
    end = np.array([[10.0, 0.0], [5.0, 8.0]])
    paths = specular_paths(start, end, [[2.0, 5.0]], [[8.0, 5.0]], order=1)
    assert not paths.visible[0, 0, 0]  # line of sight
    assert paths.visible[0, 0, 1]  # over the floor line, under the screen
    assert not paths.visible[0, 0, 2]


def test_epochs_follow_the_stated_model():
    """Detections, noise and clutter have the stated rates within four standard errors."""
    count = 4000
    paths = SpecularPaths(
        ((),), np.full((count, 1, 1), 50.0), np.ones((count, 1, 1), dtype=bool), np.zeros((count, 1, 1))
    )
    config = SimulationConfig(range_std_m=0.2, detection_probability=0.8, clutter_mean=1.5)
    epochs = simulate_epochs(paths, config, np.random.default_rng(11))
    lengths = np.concatenate([epoch.paths[0].range_m for epoch in epochs])
    near = lengths[np.abs(lengths - 50.0) < 1.0]
    expected_near = count * (0.8 + 1.5 * 2.0 / 180.0)
    assert abs(near.size - expected_near) < 4.0 * np.sqrt(expected_near)
    far = lengths[np.abs(lengths - 50.0) >= 1.0]
    expected_far = count * 1.5 * 178.0 / 180.0
    assert abs(far.size - expected_far) < 4.0 * np.sqrt(expected_far)
    inner = near[np.abs(near - 50.0) < 0.6]
    assert abs(inner.mean() - 50.0) < 4.0 * 0.2 / np.sqrt(inner.size)
    assert stats.kstest((far - 0.0) / 180.0, "uniform").pvalue > 1e-4 or far.size == 0


def test_walls_scatter_as_claimed():
    """VRPs drawn with a variance have that variance."""
    rng = np.random.default_rng(12)
    draws = np.array([simulate_walls([[20.0, 0.0]], [0.5], rng)[0].mean_m for _ in range(4000)])
    assert np.allclose(np.var(draws, axis=0), 0.5, rtol=4.0 * np.sqrt(2.0 / 4000))


def test_nonsense_is_refused():
    """Bad models and shapes say what was expected."""
    with pytest.raises(
        ConfigurationError, match="detection_probability: expected a number from 0 to 1, got 2"
    ):
        SimulationConfig(detection_probability=2)
    with pytest.raises(ConfigurationError, match="range_std_m: expected a positive number"):
        SimulationConfig(range_std_m=0.0)
    with pytest.raises(ConfigurationError, match="clutter_mean"):
        SimulationConfig(clutter_mean=-1.0)
    with pytest.raises(InputError, match="one per VRP"):
        simulate_walls([[1.0, 2.0]], [1.0, 2.0], np.random.default_rng(1))
    with pytest.raises(InputError, match="order: expected 0 or more"):
        specular_paths(SQUARE, SQUARE[::-1], [[1.0, 1.0]], [[2.0, 2.0]], order=-1)
    with pytest.raises(InputError, match="end_m: expected shape"):
        specular_paths(SQUARE, SQUARE[:2], [[1.0, 1.0]], [[2.0, 2.0]])
