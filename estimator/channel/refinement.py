"""Refining the paths of a channel: Newton steps one by one, and joint scoring.

Two refinements raise the energy that the atoms explain: :func:`cycle`, Newton steps of one path after the
other as NOMP has them, cheap and robust from a rough start; and :func:`polish`, joint Fisher scoring of all
points, which converges where paths are closer than the resolution and cycling crawls. Both use the data
through correlations at the current points alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.channel.atoms import (
    Atoms,
    Kernels,
    correlate,
    information,
    inner_products,
    kernel_at,
    spacing,
)
from estimator.channel.interpolation import Spectra
from estimator.channel.linear import factorise, solve
from estimator.compiled import compiled

__all__ = ["Channel", "Refinement", "cycle", "newton", "polish", "residual_correlation"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Channel(NamedTuple):
    """One channel; compiled functions take it as it is.

    Parameters
    ----------
    atoms : Atoms
        What its samples are.
    spectra : Spectra
        Its correlations on a grid.
    work : ndarray of complex128, shape (S, antennas, 3)
        Overwritten.
    """

    atoms: Atoms
    spectra: Spectra
    work: Complex


class Refinement(NamedTuple):
    """Settings of both refinements.

    Parameters
    ----------
    closest_cells : float
        Smallest distance of paths, resolution cells.
    newton_limit_cells, scoring_limit_cells : float
        Longest step of a coordinate of one path, and of all together, resolution cells.
    converged_cells : float
        Joint steps end where none is longer, resolution cells.
    damping, least_damping, most_damping : float
        Of joint steps (Levenberg-Marquardt): at first, and its limits.
    ridge : float
        Added to the norms of atoms, relative: keeps coinciding paths solvable.
    """

    closest_cells: float
    newton_limit_cells: float = 0.25
    scoring_limit_cells: float = 0.5
    converged_cells: float = 1e-4
    damping: float = 1e-3
    least_damping: float = 1e-9
    most_damping: float = 1e3
    ridge: float = 1e-10


@compiled
def residual_correlation(
    channel: Channel, points: Real, gain: Complex, without: int, point: Real, out: Complex
) -> None:
    """Correlation of what paths leave of a channel with the atom of a point, and its derivatives.

    Parameters
    ----------
    channel : Channel
        The channel.
    points, gain : ndarray, shape (K, D) and (S, K)
        Paths.
    without : int
        A path that is left in the channel; -1 for none.
    point : ndarray, shape (D,)
        Where, turns.
    out : ndarray of complex128, shape (S, 1 + 2 D)
        As of :func:`estimator.channel.atoms.correlate`.
    """
    axes = point.size
    slope, curvature = np.empty(axes), np.empty((axes, axes))
    correlate(channel.atoms, channel.spectra, point, channel.work, out)
    for k in range(points.shape[0]):
        if k == without:
            continue
        value = kernel_at(channel.atoms.sizes, point, points[k], slope, curvature)
        for s in range(out.shape[0]):
            out[s, 0] -= gain[s, k] * value
            for d in range(axes):
                out[s, 1 + d] -= gain[s, k] * slope[d]
                out[s, 1 + axes + d] -= gain[s, k] * curvature[d, d]


@compiled
def newton(atoms: Atoms, values: Complex, limit_cells: float, step: Real) -> None:
    """Newton step (D,) of each coordinate towards the maximum of ``sum_s |z_s(x)|^2``; 0 where it is convex.

    Parameters
    ----------
    atoms : Atoms
        The samples.
    values : ndarray of complex128, shape (S, 1 + 2 D)
        Correlations, see :func:`estimator.channel.atoms.correlate`.
    limit_cells : float
        Longest step, resolution cells.
    step : ndarray, shape (D,)
        Where it goes, turns.
    """
    axes = step.size
    for d in range(axes):
        first, second = 0.0, 0.0
        for s in range(values.shape[0]):
            z, slope, curvature = values[s, 0], values[s, 1 + d], values[s, 1 + axes + d]
            first += z.real * slope.real + z.imag * slope.imag
            second += slope.real**2 + slope.imag**2 + z.real * curvature.real + z.imag * curvature.imag
        limit = limit_cells / atoms.sizes[d]
        step[d] = min(max(-first / second, -limit), limit) if second < 0.0 else 0.0


@compiled
def cycle(channel: Channel, points: Real, gain: Complex, rounds: int, settings: Refinement) -> None:
    """Newton steps of every path in turn against the residual of the others, in place.

    Each round ends with the joint least squares of the gains.

    Parameters
    ----------
    channel : Channel
        The channel.
    points, gain : ndarray, shape (K, D) and (S, K)
        Its paths, at least one.
    rounds : int
        Rounds over all paths.
    settings : Refinement
        Limits.
    """
    atoms = channel.atoms
    paths, axes = points.shape
    values, step = np.empty((gain.shape[0], 1 + 2 * axes), np.complex128), np.empty(axes)
    for _ in range(rounds):
        for k in range(paths):
            residual_correlation(channel, points, gain, k, points[k], values)
            newton(atoms, values, settings.newton_limit_cells, step)
            for s in range(gain.shape[0]):
                z = values[s, 0]
                for d in range(axes):
                    z += step[d] * (values[s, 1 + d] + 0.5 * step[d] * values[s, 1 + axes + d])
                gain[s, k] = z / atoms.energy
            for d in range(axes):
                points[k, d] += step[d]
        kernel = inner_products(atoms.sizes, points).kernel
        for k in range(paths):
            kernel[k, k] += settings.ridge * atoms.energy
        factorise(kernel)
        right = np.empty((paths, gain.shape[0]), np.complex128)
        for k in range(paths):
            correlate(atoms, channel.spectra, points[k], channel.work, values)
            for s in range(gain.shape[0]):
                right[k, s] = values[s, 0]
        solve(kernel, right)
        for k in range(paths):
            for s in range(gain.shape[0]):
                gain[s, k] = right[k, s]


@compiled
def _project(channel: Channel, points: Real, gain: Complex, gradient: Real) -> tuple[float, Kernels, Real]:
    """Least squares of the gains and half the gradient of the energy that they explain, in place.

    Returns
    -------
    energy : float
    kernels : Kernels
        Of the points.
    upper : ndarray, shape (K, K)
        Cholesky's factor of their Gram matrix.
    """
    paths, axes = points.shape
    snapshots = gain.shape[0]
    values = np.empty((paths, snapshots, 1 + 2 * axes), np.complex128)
    right = np.empty((paths, snapshots), np.complex128)
    for k in range(paths):
        correlate(channel.atoms, channel.spectra, points[k], channel.work, values[k])
        for s in range(snapshots):
            right[k, s] = values[k, s, 0]
    kernels = inner_products(channel.atoms.sizes, points)
    upper = kernels.kernel.copy()
    factorise(upper)
    solve(upper, right)
    energy = 0.0
    for k in range(paths):
        for s in range(snapshots):
            gain[s, k] = right[k, s]
            energy += right[k, s].real * values[k, s, 0].real + right[k, s].imag * values[k, s, 0].imag
    for d in range(axes):
        for k in range(paths):
            total = 0.0
            for s in range(snapshots):
                left = values[k, s, 1 + d]
                for j in range(paths):
                    left -= kernels.slope[d, k, j] * gain[s, j]
                total += gain[s, k].real * left.real + gain[s, k].imag * left.imag
            gradient[d * paths + k] = total
    return energy, kernels, upper


@compiled
def _spaced(atoms: Atoms, points: Real, closest_cells: float) -> bool:
    """Whether no two points are closer."""
    for k in range(points.shape[0]):
        for j in range(k):
            if spacing(atoms.sizes, points[k], points[j]) < closest_cells:
                return False
    return True


@compiled
def polish(channel: Channel, points: Real, gain: Complex, steps: int, settings: Refinement) -> None:
    """Joint Fisher scoring of all points, the gains eliminated (Levenberg-Marquardt damping), in place.

    A step is taken if it raises the explained energy and leaves no two paths closer than
    ``closest_cells``: closer, the pair would turn into a derivative with opposite gains that fits what
    is not a path.

    Parameters
    ----------
    channel : Channel
        The channel.
    points, gain : ndarray, shape (K, D) and (S, K)
        Its paths, at least one, none closer than ``closest_cells``.
    steps : int
        Largest number of steps.
    settings : Refinement
        Limits.
    """
    atoms, sizes = channel.atoms, channel.atoms.sizes
    paths, axes = points.shape
    gradient, moved, other = np.empty(axes * paths), np.empty_like(points), np.empty_like(gain)
    step, trial = np.empty((axes * paths, 1)), np.empty(axes * paths)
    matrix, damping, energy = np.zeros((axes * paths, axes * paths)), settings.damping, -1.0
    for k in range(paths):
        for d in range(axes):
            moved[k, d] = points[k, d]
    largest = np.inf
    for number in range(steps + 1):
        better = number == 0 or _spaced(atoms, moved, settings.closest_cells)
        if better:
            found, kernels, upper = _project(channel, moved, other, trial)
            better = found >= energy
            if better:
                energy = found
                for k in range(paths):
                    for d in range(axes):
                        points[k, d], gradient[d * paths + k] = moved[k, d], trial[d * paths + k]
                    for s in range(gain.shape[0]):
                        gain[s, k] = other[s, k]
                matrix = information(kernels, upper, gain)
        if number > 0:
            damping *= 0.2 if better else 10.0
            damping = min(max(damping, settings.least_damping), settings.most_damping)
        if number == steps or largest <= settings.converged_cells:
            break
        damped = matrix.copy()
        for d in range(axes):
            curvature = atoms.energy * max((sizes[d] ** 2 - 1.0) * np.pi**2 / 3.0, 1.0)  # minus the kernel's
            for k in range(paths):
                i, power = d * paths + k, 0.0
                for s in range(gain.shape[0]):
                    power += gain[s, k].real ** 2 + gain[s, k].imag ** 2
                damped[i, i] += damping * curvature * power
                step[i, 0] = gradient[i]
        factorise(damped)
        solve(damped, step)
        largest = 0.0
        for d in range(axes):
            limit = settings.scoring_limit_cells / sizes[d]
            for k in range(paths):
                by = min(max(step[d * paths + k, 0], -limit), limit)
                moved[k, d] = points[k, d] + by
                largest = max(largest, abs(by) * sizes[d])
