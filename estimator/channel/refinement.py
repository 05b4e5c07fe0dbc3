"""Refining the paths of a batch of channels that have equally many each.

A :class:`Fit` holds C channels with K paths each, points with D coordinates (delay, and directions; see
:mod:`estimator.channel.atoms`) and gains in S snapshots. Two refinements raise the energy that the atoms
explain: :func:`cycle`, Newton steps of one path after the other as NOMP has
them, cheap and robust from a rough start; and :func:`polish`, joint Fisher scoring of all
points, which converges where paths are closer than the resolution and cycling crawls.
Both use the data through correlations at the current points alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.channel.atoms import SeparableAtoms
from estimator.channel.model import ToneBlocks

__all__ = ["Fit", "cycle", "newton_step", "polish", "widely_spaced"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rows = NDArray[np.bool_]

_NEWTON_LIMIT_CELLS = 0.25
_SCORING_LIMIT_CELLS = 0.5
_CONVERGED_CELLS = 1e-4
_DAMPING_RANGE = (1e-9, 1e3)
_RIDGE = 1e-10  # keeps coinciding paths solvable


@dataclass(frozen=True, eq=False)
class Fit:
    """Channels and the paths found in them.

    Parameters
    ----------
    index : ndarray of int, shape (C,)
        Which channel each row is.
    data : ndarray of complex128, shape (C, S, antennas, tones)
        The CFRs.
    blocks : ToneBlocks
        The same, prepared for correlation.
    noise_variance : ndarray, shape (C,)
        Noise variance per tone and antenna.
    points : ndarray, shape (C, K, D)
        Paths, in turns along each axis.
    gain : ndarray of complex128, shape (C, S, K)
        Gains.
    """

    index: NDArray[np.intp]
    data: Complex
    blocks: ToneBlocks
    noise_variance: Real
    points: Real
    gain: Complex

    def take(self, rows: Rows, points: Real | None = None, gain: Complex | None = None) -> Fit:
        """A selection of the channels, with other paths where ``points`` and ``gain`` are given."""
        return Fit(
            self.index[rows],
            self.data[rows],
            self.blocks.take(rows),
            self.noise_variance[rows],
            self.points[rows] if points is None else points,
            self.gain[rows] if gain is None else gain,
        )

    def with_paths(self, points: Real, gain: Complex) -> Fit:
        """The same channels with other paths."""
        return Fit(self.index, self.data, self.blocks, self.noise_variance, points, gain)

    def residual(self, atoms: SeparableAtoms) -> Complex:
        """What the paths leave of the data, shape (C, S, antennas, tones)."""
        return np.asarray(self.data - atoms.synthesise(self.points, self.gain))

    @property
    def power(self) -> Real:
        """Mean power of every path over the snapshots, shape (C, K)."""
        return np.asarray(np.mean(np.abs(self.gain) ** 2, axis=1))


def widely_spaced(atoms: SeparableAtoms, fit: Fit, closest_cells: float) -> Rows:
    """Paths, shape (C, K), that have no stronger kept path within ``closest_cells`` on all axes."""
    rank = np.argsort(-fit.power, axis=1, kind="stable")
    close = atoms.spacing(np.take_along_axis(fit.points, rank[..., None], axis=1)) < closest_cells
    kept = np.ones(rank.shape, dtype=bool)
    for k in range(1, rank.shape[1]):
        kept[:, k] = ~np.any(kept[:, :k] & close[:, k, :k], axis=1)
    unranked = np.empty_like(kept)
    np.put_along_axis(unranked, rank, kept, axis=1)
    return unranked


def newton_step(z: Complex, slope: Complex, curvature: Complex, atoms: SeparableAtoms) -> Real:
    """Newton step of each coordinate towards the maximum of ``sum_s |z_s(x)|^2``; zero where it is convex.

    Parameters
    ----------
    z, slope, curvature : ndarray of complex128, shapes (C, S, K) and (C, S, D, K)
        Correlations, see :meth:`SeparableAtoms.correlate`.
    atoms : SeparableAtoms
        The axes.

    Returns
    -------
    ndarray, shape (C, K, D)
        Turns.
    """
    z = z[:, :, None]
    first = np.sum(np.real(np.conj(z) * slope), axis=1)
    second = np.sum(np.abs(slope) ** 2 + np.real(np.conj(z) * curvature), axis=1)
    concave = second < 0.0
    step = -first / np.where(concave, second, -1.0)
    limit = _NEWTON_LIMIT_CELLS / atoms.sizes[:, None]
    return np.swapaxes(np.where(concave, np.clip(step, -limit, limit), 0.0), 1, 2)


def _solve(matrix: Real, right: Real | Complex) -> NDArray[np.complex128]:
    """Solutions of (C, n, n) for right sides (C, S, n)."""
    return np.asarray(np.swapaxes(np.linalg.solve(matrix, np.swapaxes(right, 1, 2)), 1, 2))


def cycle(atoms: SeparableAtoms, fit: Fit, rounds: int) -> Fit:
    """Newton steps of every path in turn against the residual of the others.

    Each round ends with the joint least squares of the gains.

    Parameters
    ----------
    atoms : SeparableAtoms
        Atoms on the axes of ``fit``.
    fit : Fit
        Channels with at least one path.
    rounds : int
        Rounds over all paths.

    Returns
    -------
    Fit
    """
    points, gain = fit.points.copy(), fit.gain.copy()
    paths = points.shape[1]
    for _ in range(rounds):
        correlations = atoms.correlate(fit.blocks, points)
        for k in range(paths):
            others = np.arange(paths) != k
            near = atoms.kernels(points[:, k : k + 1, None] - points[:, None, others])
            own = np.arange(atoms.axes)
            z = correlations[0][:, :, k] - np.einsum("cl,csl->cs", near.kernel[:, 0], gain[:, :, others])
            slope, curvature = (
                correlation[..., k] - np.einsum("cdl,csl->csd", kernel[:, :, 0], gain[:, :, others])
                for correlation, kernel in zip(
                    correlations[1:], (near.slope, near.curvature[:, own, own]), strict=True
                )
            )
            step = newton_step(z[..., None], slope[..., None], curvature[..., None], atoms)[:, 0]
            points[:, k] += step
            by = step[:, None]
            gain[:, :, k] = (z + np.sum(by * (slope + 0.5 * by * curvature), axis=-1)) / atoms.energy
        z = atoms.correlate(fit.blocks, points)[0]
        kernel = atoms.kernels(points[:, :, None] - points[:, None]).kernel
        gain = _solve(kernel + _RIDGE * atoms.energy * np.eye(paths), z)
    return fit.with_paths(points, gain)


@dataclass(frozen=True, eq=False)
class _Projection:
    """Least squares of the gains at given points, and what scoring needs besides."""

    points: Real
    gain: Complex
    energy: Real  # the energy that the atoms explain, (C,)
    gradient: Real  # half its gradient by the points, (C, D K), coordinates slowest
    information: Real  # (C, D K, D K)

    @classmethod
    def at(cls, atoms: SeparableAtoms, blocks: ToneBlocks, points: Real) -> _Projection:
        z, slope, _ = atoms.correlate(blocks, points)
        kernels = atoms.kernels(points[:, :, None] - points[:, None])
        gain = _solve(kernels.kernel, z)
        energy = np.real(np.sum(np.conj(gain) * z, axis=(1, 2)))
        left = slope - np.einsum("cdkl,csl->csdk", kernels.slope, gain)
        gradient = np.real(np.sum(np.conj(gain)[:, :, None] * left, axis=1)).reshape(len(z), -1)
        return cls(points, gain, energy, gradient, kernels.information(gain))

    def where(self, rows: Rows, other: _Projection) -> _Projection:
        """The rows of this one where ``rows`` is true, of ``other`` elsewhere."""
        vector, matrix = rows[:, None], rows[:, None, None]
        return _Projection(
            np.where(matrix, self.points, other.points),
            np.where(matrix, self.gain, other.gain),
            np.where(rows, self.energy, other.energy),
            np.where(vector, self.gradient, other.gradient),
            np.where(matrix, self.information, other.information),
        )


def polish(atoms: SeparableAtoms, fit: Fit, steps: int, closest_cells: float) -> Fit:
    """Joint Fisher scoring of all points, the gains eliminated (Levenberg-Marquardt damping).

    A step is taken in those channels where it raises the explained energy and leaves no two
    paths closer than ``closest_cells``: closer, the pair would turn into a
    derivative with opposite gains that fits what is not a path.

    Parameters
    ----------
    atoms : SeparableAtoms
        Atoms on the axes of ``fit``.
    fit : Fit
        Channels with at least one path, none closer than ``closest_cells``.
    steps : int
        Largest number of steps.
    closest_cells : float
        Smallest distance of paths, resolution cells.

    Returns
    -------
    Fit
    """
    channels, paths, axes = fit.points.shape
    sizes = np.repeat(atoms.sizes, paths)
    curvature = atoms.energy * (sizes**2 - 1.0) * np.pi**2 / 3.0  # minus the kernel's at 0
    apart = 2.0 * closest_cells * np.eye(paths)
    damping = np.full(channels, 1e-3)
    active = np.ones(channels, dtype=bool)
    best = _Projection.at(atoms, fit.blocks, fit.points)
    for _ in range(steps):
        power = np.tile(np.sum(np.abs(best.gain) ** 2, axis=1), (1, axes))
        diagonal = damping[:, None] * np.maximum(curvature, atoms.energy) * power
        damped = best.information + diagonal[:, :, None] * np.eye(axes * paths)
        step = _solve(damped, best.gradient[:, None])[:, 0].real
        step = np.clip(step, -_SCORING_LIMIT_CELLS / sizes, _SCORING_LIMIT_CELLS / sizes)
        moved = best.points + np.swapaxes(step.reshape(channels, axes, paths), 1, 2)
        spaced = np.min(atoms.spacing(moved) + apart, axis=(1, 2)) >= closest_cells
        trial = _Projection.at(atoms, fit.blocks, np.where(spaced[:, None, None], moved, best.points))
        better = active & spaced & (trial.energy >= best.energy)
        best = trial.where(better, best)
        damping = np.clip(np.where(better, 0.2 * damping, 10.0 * damping), *_DAMPING_RANGE)
        active &= np.max(np.abs(step) * sizes, axis=1) > _CONVERGED_CELLS
        if not np.any(active):
            break
    return fit.with_paths(best.points, best.gain)
