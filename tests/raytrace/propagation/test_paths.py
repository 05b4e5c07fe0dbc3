"""Lists and grids of paths: padding, order, and the way back."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from raytrace.propagation.directions import angles_of
from raytrace.propagation.paths import NO_INTERACTION, NO_SURFACE, SPECULAR, PathList, PathSet


def random_paths(rng: np.random.Generator, count: int, bounces: int = 2) -> PathList:
    order = rng.integers(0, bounces + 1, count).astype(np.int16)
    walls = rng.integers(0, 6, (count, bounces)).astype(np.int16)
    walls[np.arange(bounces) >= order[:, None]] = NO_SURFACE
    return PathList(
        epoch=rng.integers(0, 4, count),
        anchor=rng.integers(0, 3, count),
        delay_s=rng.choice([1e-8, 2e-8, 3e-8], count),
        amplitude=rng.standard_normal(count) + 1j * rng.standard_normal(count),
        departure_azimuth_rad=rng.uniform(-3, 3, count),
        departure_elevation_rad=rng.uniform(-1, 1, count),
        arrival_azimuth_rad=rng.uniform(-3, 3, count),
        arrival_elevation_rad=rng.uniform(-1, 1, count),
        order=order,
        walls=walls,
        interactions=np.where(walls == NO_SURFACE, NO_INTERACTION, SPECULAR).astype(np.int8),
        transfer=np.zeros((count, 0, 0), dtype=np.complex128),
    )


def test_grid_and_back() -> None:
    """Padding to a grid and flattening again gives the list in canonical order, nothing lost."""
    paths = random_paths(np.random.default_rng(1), 60)
    grid = PathSet.build(paths, 4, 3)
    assert grid.valid.sum() == 60
    back, sorted_list = grid.flat(), paths.canonical()
    for field in fields(PathList):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(sorted_list, field.name))


def test_canonical_order_forgets_the_order_of_arrival() -> None:
    """However the tracer happened to store the paths, the grid is the same."""
    rng = np.random.default_rng(2)
    paths = random_paths(rng, 60)
    shuffled = paths.select(rng.permutation(60))
    one, other = PathSet.build(paths, 4, 3), PathSet.build(shuffled, 4, 3)
    np.testing.assert_array_equal(one.walls, other.walls)
    np.testing.assert_array_equal(one.delay_s, other.delay_s)
    steps = np.diff(one.delay_s, axis=-1)
    assert np.all(steps[np.isfinite(steps)] >= 0)


def test_empty_slots_are_marked() -> None:
    """Slots without a path are invalid, NaN and without walls; an empty list has one slot."""
    grid = PathSet.build(random_paths(np.random.default_rng(3), 5), 4, 3)
    empty = ~grid.valid
    assert np.isnan(grid.delay_s[empty]).all()
    assert not grid.amplitude[empty].any()
    assert (grid.walls[empty] == NO_SURFACE).all()
    nothing = PathSet.build(random_paths(np.random.default_rng(3), 0), 4, 3)
    assert nothing.valid.shape == (4, 3, 1)
    assert len(nothing.flat()) == 0


def test_keys_tell_paths_apart() -> None:
    """Keys are equal exactly where epoch, anchor and walls are."""
    paths = random_paths(np.random.default_rng(4), 400)
    rows = np.column_stack([paths.epoch, paths.anchor, paths.walls])
    keys = paths.keys(anchors=3, surfaces=6)
    assert len(np.unique(keys)) == len(np.unique(rows, axis=0))
    _, of_row = np.unique(rows, axis=0, return_inverse=True)
    _, of_key = np.unique(keys, return_inverse=True)
    np.testing.assert_array_equal(of_row.ravel(), of_key.ravel())


def test_concatenation_pads_the_walls() -> None:
    """Lists of different depths can be joined; the shallower one's walls are padded."""
    rng = np.random.default_rng(5)
    joined = PathList.concatenate([random_paths(rng, 3, 1), random_paths(rng, 4, 3)])
    assert joined.walls.shape == (7, 3)
    assert (joined.walls[:3, 1:] == NO_SURFACE).all()
    np.testing.assert_array_equal(np.sum(joined.walls != NO_SURFACE, axis=1), joined.order)


def test_angles_of_axes() -> None:
    """Azimuth counts counter-clockwise from x, elevation up from the horizontal."""
    azimuth, elevation = angles_of(np.array([[1.0, 0, 0], [0, 2.0, 0], [-1, 0, 0], [1, 0, 1], [0, 0, -3]]))
    np.testing.assert_allclose(azimuth[:4], [0, np.pi / 2, np.pi, 0])
    np.testing.assert_allclose(elevation, [0, 0, 0, np.pi / 4, -np.pi / 2])
