"""Finding the paths of one channel one by one, and what is claimed of them; see :mod:`.nomp`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.channel.atoms import Atoms, information, inner_products, spacing
from estimator.channel.linear import factorise, invert
from estimator.channel.refinement import Channel, Refinement, cycle, newton, polish, residual_correlation
from estimator.channel.search import Grid, GridCorrelations, strongest
from estimator.compiled import compiled

__all__ = ["Pursuit", "covariances", "pursue"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NEIGHBOURHOOD_CELLS = (-2.0, -1.0, 1.0, 2.0)  # where the residual's level is taken
_TURN_VARIANCE = 1.0 / 12.0  # of a point anywhere in a turn
_SIGNIFICANT_LEVEL = 3.0  # of the residual, over the noise: four standard deviations of its mean


class Pursuit(NamedTuple):
    """Settings of a pursuit.

    Parameters
    ----------
    least_energy : float
        Squared correlation, over the atom's energy and summed over snapshots, of a path.
    range_ratio : float
        Least power of a path over that of the strongest.
    max_paths : int
        Largest number of paths.
    newton_steps, cycles, polish_steps, final_steps : int
        See :class:`estimator.channel.nomp.NompConfig`.
    """

    least_energy: float
    range_ratio: float
    max_paths: int
    newton_steps: int
    cycles: int
    polish_steps: int
    final_steps: int


@compiled
def pursue(
    channel: Channel, grid: Grid, correlations: GridCorrelations, settings: Pursuit, limits: Refinement
) -> tuple[Real, Complex]:
    """The paths of a channel: points (K, D), in turns, and gains (S, K).

    Parameters
    ----------
    channel : Channel
        The channel.
    grid : Grid
        Where peaks are searched.
    correlations : GridCorrelations
        The channel on this grid.
    settings : Pursuit
        When to stop.
    limits : Refinement
        Limits of the refinements.
    """
    atoms = channel.atoms
    snapshots, axes = channel.work.shape[0], atoms.sizes.size
    points, gain = np.empty((0, axes)), np.empty((snapshots, 0), np.complex128)
    point, step = np.empty(axes), np.empty(axes)
    values = np.empty((snapshots, 1 + 2 * axes), np.complex128)
    more, greatest = True, 0.0
    while more:
        strongest(grid, correlations, points, gain, point)
        for number in range(settings.newton_steps + 1):
            residual_correlation(channel, points, gain, -1, point, values)
            if number < settings.newton_steps:
                newton(atoms, values, limits.newton_limit_cells, step)
                for d in range(axes):
                    point[d] += step[d]
        energy = 0.0
        for s in range(snapshots):
            energy += values[s, 0].real ** 2 + values[s, 0].imag ** 2
        power = energy / (snapshots * atoms.energy**2)
        more = energy > settings.least_energy * atoms.energy and power > greatest * settings.range_ratio
        more = more and points.shape[0] < settings.max_paths
        if more:
            points, gain = _with_path(points, gain, point, values, atoms.energy)
            cycle(channel, points, gain, settings.cycles, limits)
        else:
            points, gain = _without_duplicates(atoms, points, gain, limits.closest_cells)
        if points.shape[0] > 0:
            polish(channel, points, gain, settings.polish_steps if more else settings.final_steps, limits)
        greatest = 0.0
        for own in _powers(gain):
            greatest = max(greatest, own)
    return points, gain


@compiled
def _with_path(
    points: Real, gain: Complex, point: Real, values: Complex, energy: float
) -> tuple[Real, Complex]:
    """Paths with one more, whose gains are its correlations over the atom's energy."""
    paths, axes, snapshots = points.shape[0], point.size, gain.shape[0]
    more, gains = np.empty((paths + 1, axes)), np.empty((snapshots, paths + 1), np.complex128)
    for k in range(paths + 1):
        for d in range(axes):
            more[k, d] = points[k, d] if k < paths else point[d]
        for s in range(snapshots):
            gains[s, k] = gain[s, k] if k < paths else values[s, 0] / energy
    return more, gains


@compiled
def _powers(gain: Complex) -> Real:
    """Mean power of every path over the snapshots, shape (K,)."""
    power = np.zeros(gain.shape[1])
    for s in range(gain.shape[0]):
        for k in range(gain.shape[1]):
            power[k] += (gain[s, k].real ** 2 + gain[s, k].imag ** 2) / gain.shape[0]
    return power


@compiled
def _without_duplicates(
    atoms: Atoms, points: Real, gain: Complex, closest_cells: float
) -> tuple[Real, Complex]:
    """The paths that have no stronger kept path within ``closest_cells`` on all axes, in their order."""
    power, paths = _powers(gain), gain.shape[1]
    state = np.zeros(paths, np.int64)  # 0 not looked at, 1 kept, 2 dropped
    count = 0
    for _ in range(paths):
        best = -1
        for k in range(paths):
            if state[k] == 0 and (best < 0 or power[k] > power[best]):
                best = k
        state[best] = 1
        for k in range(paths):
            if state[k] == 1 and k != best and spacing(atoms.sizes, points[k], points[best]) < closest_cells:
                state[best] = 2
        count += state[best] == 1
    kept, gains = np.empty((count, points.shape[1])), np.empty((gain.shape[0], count), np.complex128)
    i = 0
    for k in range(paths):
        if state[k] == 1:
            for d in range(points.shape[1]):
                kept[i, d] = points[k, d]
            for s in range(gain.shape[0]):
                gains[s, i] = gain[s, k]
            i += 1
    return kept, gains


@compiled
def covariances(channel: Channel, points: Real, gain: Complex, noise: float) -> Real:
    """Covariances (K, D, D) of the points of paths, square turns; floors are not in them.

    Parameters
    ----------
    channel : Channel
        The channel.
    points, gain : ndarray, shape (K, D) and (S, K)
        Its paths.
    noise : float
        Noise variance of a sample.
    """
    atoms = channel.atoms
    paths, axes = points.shape
    kernels = inner_products(atoms.sizes, points)
    upper = kernels.kernel.copy()
    factorise(upper)
    bound = information(kernels, upper, gain)
    invert(bound)
    power, around = _powers(gain), np.empty(axes)
    values = np.empty((gain.shape[0], 1 + 2 * axes), np.complex128)
    claimed = np.empty((paths, axes, axes))
    for k in range(paths):
        level = 0.0
        for cells in _NEIGHBOURHOOD_CELLS:
            for d in range(axes):
                around[d] = points[k, d]
            around[0] += cells / atoms.sizes[0]
            residual_correlation(channel, points, gain, -1, around, values)
            for s in range(gain.shape[0]):
                level += values[s, 0].real ** 2 + values[s, 0].imag ** 2
        level /= len(_NEIGHBOURHOOD_CELLS) * gain.shape[0] * atoms.energy
        excess = max(0.0, level - _SIGNIFICANT_LEVEL * noise) / atoms.energy
        cells2 = np.sqrt(excess / power[k])
        for d in range(axes):
            for e in range(axes):
                claimed[k, d, e] = 0.5 * max(noise, level) * bound[d * paths + k, e * paths + k]
            claimed[k, d, d] += cells2 / atoms.sizes[d] ** 2
        for d in range(axes):  # whatever is not known lies in one turn
            shrink = np.sqrt(min(1.0, _TURN_VARIANCE / claimed[k, d, d]))
            for e in range(axes):
                claimed[k, d, e] *= shrink
                claimed[k, e, d] *= shrink
    return claimed
