"""The search of the grid against the correlations of the residual written out."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.search import PeakSearch, strongest

pytestmark = pytest.mark.interpreted


@pytest.mark.parametrize(("tones", "shape"), [(33, ()), (64, ()), (819, ()), (40, (4,)), (30, (3, 4))])
def test_the_strongest_point_of_the_residual_is_found(tones: int, shape: tuple[int, ...]) -> None:
    """Paths are taken off exactly, on the grid's points and off them: what is left has its peak there."""
    rng = np.random.default_rng(tones)
    search = PeakSearch(tones, shape, (0.5,) * len(shape), 4)
    antennas, axes = int(np.prod(shape, dtype=int)), 1 + len(shape)
    places = np.indices((tones, *shape)).reshape(axes, tones, antennas)
    places = places - 0.5 * (np.array([tones, *shape])[:, None, None] - 1.0)

    def atoms(points):
        return np.exp(-2j * np.pi * np.einsum("kd,dna->kan", points, places))

    data = rng.normal(size=(2, antennas, tones)) + 1j * rng.normal(size=(2, antennas, tones))
    bins, turns = search.grid.trigonometry.shape[1], search.grid.turns
    points = rng.uniform(-0.4, 0.4, (3, axes))
    points[0, 0], points[1, 0] = 5.0 / bins, 1.0 + 1e-9  # on the grid, and a turn further hardly off it
    gain = 3.0 * (rng.normal(size=(2, 3)) + 1j * rng.normal(size=(2, 3)))
    found = np.empty(axes)
    strongest(search.grid, search.of(data), points, gain, found)
    grid = np.array([[m / bins, *turn] for turn in turns for m in range(bins)])
    residual = data - np.einsum("sk,kan->san", gain, atoms(points))
    energy = np.concatenate(
        [
            np.sum(np.abs(np.einsum("kan,san->sk", atoms(some).conj(), residual)) ** 2, axis=0)
            for some in np.array_split(grid, 20)
        ]
    )
    here = np.flatnonzero(np.all(np.isclose(grid, found, atol=1e-12), axis=1))[0]
    assert energy[here] == pytest.approx(energy.max(), rel=1e-4)
