"""Refining the delays of a batch of channels that have equally many paths each.

A :class:`Fit` holds C channels with K paths each. Two refinements raise the energy that the
atoms explain: :func:`cycle`, Newton steps of one path after the other as NOMP has
them, cheap and robust from a rough start; and :func:`polish`, joint Fisher scoring of all
delays, which converges where paths are closer than the resolution and cycling crawls.
Both use the data through correlations at the current delays alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.channel.model import ToneBlocks, ToneCorrelator, delay_information, dirichlet

__all__ = ["Fit", "cycle", "newton_step", "polish", "spacing", "widely_spaced"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rows = NDArray[np.bool_]

_NEWTON_LIMIT_CELLS = 0.25
_SCORING_LIMIT_CELLS = 0.5
_CONVERGED_CELLS = 1e-4
_DAMPING_RANGE = (1e-9, 1e3)
_RIDGE = 1e-10  # keeps coinciding delays solvable


@dataclass(frozen=True, eq=False)
class Fit:
    """Channels and the paths found in them.

    Parameters
    ----------
    index : ndarray of int, shape (C,)
        Which channel each row is.
    cfr : ndarray of complex128, shape (C, N)
        The CFRs.
    blocks : ToneBlocks
        The same, prepared for correlation.
    noise_variance : ndarray, shape (C,)
        Noise variance per tone.
    turns : ndarray, shape (C, K)
        Delays in turns.
    gain : ndarray of complex128, shape (C, K)
        Gains.
    """

    index: NDArray[np.intp]
    cfr: Complex
    blocks: ToneBlocks
    noise_variance: Real
    turns: Real
    gain: Complex

    def take(self, rows: Rows, turns: Real | None = None, gain: Complex | None = None) -> Fit:
        """A selection of the channels, with other paths where ``turns`` and ``gain`` are given."""
        return Fit(
            self.index[rows],
            self.cfr[rows],
            self.blocks.take(rows),
            self.noise_variance[rows],
            self.turns[rows] if turns is None else turns,
            self.gain[rows] if gain is None else gain,
        )

    def residual(self, correlator: ToneCorrelator) -> Complex:
        """What the paths leave of the CFRs, shape (C, N)."""
        return np.asarray(self.cfr - correlator.synthesise(self.turns, self.gain))


def spacing(turns: Real, tones: int) -> Real:
    """Distances between delays in resolution cells, around the turn, shape (C, K, K)."""
    difference = turns[..., :, None] - turns[..., None, :]
    return np.asarray(np.abs(difference - np.rint(difference)) * tones)


def widely_spaced(turns: Real, gain: Complex, tones: int, closest_cells: float) -> Rows:
    """Paths, shape (C, K), that have no stronger kept path within ``closest_cells``."""
    rank = np.argsort(-np.abs(gain), axis=1, kind="stable")
    close = spacing(np.take_along_axis(turns, rank, axis=1), tones) < closest_cells
    kept = np.ones(turns.shape, dtype=bool)
    for k in range(1, turns.shape[1]):
        kept[:, k] = ~np.any(kept[:, :k] & close[:, k, :k], axis=1)
    unranked = np.empty_like(kept)
    np.put_along_axis(unranked, rank, kept, axis=1)
    return unranked


def newton_step(z: Complex, slope: Complex, curvature: Complex, tones: int) -> Real:
    """Newton step towards the maximum of ``|z(x)|^2``, in turns; zero where it is convex."""
    first = np.real(np.conj(z) * slope)
    second = np.abs(slope) ** 2 + np.real(np.conj(z) * curvature)
    concave = second < 0.0
    step = -first / np.where(concave, second, -1.0)
    limit = _NEWTON_LIMIT_CELLS / tones
    return np.where(concave, np.clip(step, -limit, limit), 0.0)


def _solve(matrix: Real, vector: Real | Complex) -> NDArray[np.complex128]:
    return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0])


def cycle(correlator: ToneCorrelator, fit: Fit, rounds: int) -> Fit:
    """Newton steps of every path in turn against the residual of the others.

    Each round ends with the joint least squares of the gains.

    Parameters
    ----------
    correlator : ToneCorrelator
        Correlations on the tones of ``fit``.
    fit : Fit
        Channels with at least one path.
    rounds : int
        Rounds over all paths.

    Returns
    -------
    Fit
    """
    tones, turns, gain = correlator.tones, fit.turns.copy(), fit.gain.copy()
    paths = turns.shape[1]
    for _ in range(rounds):
        correlations = correlator.correlate(fit.blocks, turns)
        for k in range(paths):
            others = np.arange(paths) != k
            kernels = dirichlet(turns[:, k, None] - turns[:, others], tones)
            z, slope, curvature = (
                correlation[:, k] - np.einsum("ck,ck->c", kernel, gain[:, others])
                for correlation, kernel in zip(correlations, kernels, strict=True)
            )
            step = newton_step(z, slope, curvature, tones)
            turns[:, k] += step
            gain[:, k] = (z + step * (slope + 0.5 * step * curvature)) / tones
        z = correlator.correlate(fit.blocks, turns)[0]
        kernel = dirichlet(turns[:, :, None] - turns[:, None, :], tones)[0]
        gain = _solve(kernel + _RIDGE * tones * np.eye(paths), z)
    return fit.take(np.ones(len(turns), dtype=bool), turns, gain)


@dataclass(frozen=True, eq=False)
class _Projection:
    """Least squares of the gains at given delays, and what scoring needs besides."""

    turns: Real
    gain: Complex
    energy: Real  # the energy that the atoms explain, (C,)
    gradient: Real  # half its gradient in the delays, (C, K)
    information: Real  # (C, K, K)

    @classmethod
    def at(cls, correlator: ToneCorrelator, blocks: ToneBlocks, turns: Real) -> _Projection:
        z, slope, _ = correlator.correlate(blocks, turns)
        kernels = dirichlet(turns[:, :, None] - turns[:, None, :], correlator.tones)
        gain = _solve(kernels[0], z)
        energy = np.real(np.einsum("ck,ck->c", np.conj(gain), z))
        residual_slope = slope - np.einsum("ckl,cl->ck", kernels[1], gain)
        gradient = np.real(np.conj(gain) * residual_slope)
        return cls(turns, gain, energy, gradient, delay_information(*kernels, gain))

    def where(self, rows: Rows, other: _Projection) -> _Projection:
        """The rows of this one where ``rows`` is true, of ``other`` elsewhere."""
        vector, matrix = rows[:, None], rows[:, None, None]
        return _Projection(
            np.where(vector, self.turns, other.turns),
            np.where(vector, self.gain, other.gain),
            np.where(rows, self.energy, other.energy),
            np.where(vector, self.gradient, other.gradient),
            np.where(matrix, self.information, other.information),
        )


def polish(correlator: ToneCorrelator, fit: Fit, steps: int, closest_cells: float) -> Fit:
    """Joint Fisher scoring of all delays, the gains eliminated (Levenberg-Marquardt damping).

    A step is taken in those channels where it raises the explained energy and leaves no two
    paths closer than ``closest_cells``: closer, the pair would turn into a delay
    derivative with opposite gains that fits what is not a path.

    Parameters
    ----------
    correlator : ToneCorrelator
        Correlations on the tones of ``fit``.
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
    tones, paths = correlator.tones, fit.turns.shape[1]
    limit = _SCORING_LIMIT_CELLS / tones
    curvature = tones * (tones**2 - 1.0) * np.pi**2 / 3.0  # -D''(0)
    apart = 2.0 * closest_cells * np.eye(paths)
    damping = np.full(len(fit.turns), 1e-3)
    active = np.ones(len(fit.turns), dtype=bool)
    best = _Projection.at(correlator, fit.blocks, fit.turns)
    for _ in range(steps):
        diagonal = damping[:, None] * curvature * np.abs(best.gain) ** 2
        step = _solve(best.information + diagonal[:, :, None] * np.eye(paths), best.gradient).real
        step = np.clip(step, -limit, limit)
        spaced = np.min(spacing(best.turns + step, tones) + apart, axis=(1, 2)) >= closest_cells
        trial = _Projection.at(correlator, fit.blocks, best.turns + np.where(spaced[:, None], step, 0.0))
        better = active & spaced & (trial.energy >= best.energy)
        best = trial.where(better, best)
        damping = np.clip(np.where(better, 0.2 * damping, 10.0 * damping), *_DAMPING_RANGE)
        active &= np.max(np.abs(step), axis=1) * tones > _CONVERGED_CELLS
        if not np.any(active):
            break
    return fit.take(np.ones(len(fit.turns), dtype=bool), best.turns, best.gain)
