"""Paths in noise that is not white over the tones: search, joint refinement, significance and bounds.

What :mod:`estimator.channel.refinement` does for white noise, for the Toeplitz covariances of
:mod:`estimator.channel.toeplitz` and one antenna. The channel, its atoms and their derivatives are whitened;
in what comes out, estimation is least squares. With K paths a joint step costs O(K N^2) operations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.channel.model import tone_atoms
from estimator.channel.refinement import Refinement
from estimator.channel.toeplitz import Inverse, whiten

__all__ = ["ColouredFit", "fit_gains", "refine", "strongest_in"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class ColouredFit(NamedTuple):
    """Paths of a channel and what the data say of them.

    Parameters
    ----------
    turns : ndarray, shape (K,)
        Delays, turns.
    gain : ndarray of complex128, shape (K,)
        Gains of the weighted least squares.
    energy : float
        Whitened energy that the paths leave.
    gradient : ndarray, shape (K,)
        Half the descent of ``energy`` by the delays.
    information : ndarray, shape (K, K)
        Half the Fisher information of the delays, the gains eliminated.
    significance : ndarray, shape (K,)
        Energy that is left besides if a path is taken out and the gains of the others are fitted again.
    """

    turns: Real
    gain: Complex
    energy: float
    gradient: Real
    information: Real
    significance: Real


def fit_gains(cfr: Complex, turns: Real, column: Complex) -> ColouredFit:
    """Gains of paths, and how well their delays are told.

    Parameters
    ----------
    cfr : ndarray of complex128, shape (N,)
        The channel.
    turns : ndarray, shape (K,)
        Delays, turns, at most as many as tones.
    column : ndarray of complex128, shape (N,)
        First column of the covariance of the noise.
    """
    tones, paths = len(cfr), len(turns)
    atoms = tone_atoms(turns, tones)
    slopes = -2j * np.pi * (np.arange(tones) - 0.5 * (tones - 1)) * atoms
    white = whiten(column, np.concatenate([cfr[None], atoms, slopes])).values
    channel, atoms, slopes = white[0], white[1 : 1 + paths], white[1 + paths :]
    basis, triangle = np.linalg.qr(atoms.T)
    explained = np.conj(basis.T) @ channel
    inverse = np.linalg.inv(triangle)
    gain = inverse @ explained
    left = channel - basis @ explained
    slopes = slopes - (slopes @ np.conj(basis)) @ basis.T
    moved = gain[:, None] * slopes
    return ColouredFit(
        turns,
        gain,
        float(np.vdot(left, left).real),
        np.real(np.conj(moved) @ left),
        np.real(np.conj(moved) @ moved.T),
        np.abs(gain) ** 2 / np.sum(np.abs(inverse) ** 2, axis=1),
    )


def refine(
    cfr: Complex, turns: Real, column: Complex, steps: int, limits: Refinement, held: int = -1
) -> ColouredFit:
    """Joint scoring of the delays but that of the path ``held``, at most ``steps`` steps.

    Other parameters are those of :func:`fit_gains`. Steps are damped (Levenberg-Marquardt); one is taken if
    it lowers the energy that is left and leaves no two paths closer than ``limits.closest_cells``.
    """
    best, damping, tones = fit_gains(cfr, turns, column), limits.damping, len(cfr)
    own = np.flatnonzero(np.arange(len(turns)) != held)
    limit = limits.scoring_limit_cells / tones
    for _ in range(steps if len(own) else 0):
        matrix, step = best.information[np.ix_(own, own)], np.zeros(len(turns))
        damped = matrix + damping * np.diag(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        step[own] = np.clip(np.linalg.solve(damped, best.gradient[own]), -limit, limit)
        moved, better = best.turns + step, False
        if _least_gap(moved) * tones >= limits.closest_cells:
            other = fit_gains(cfr, moved, column)
            better = other.energy <= best.energy
        damping = np.clip(damping * (0.2 if better else 10.0), limits.least_damping, limits.most_damping)
        if better:
            best = other
        if np.max(np.abs(step)) * tones <= limits.converged_cells:
            break
    return best


def _least_gap(turns: Real) -> float:
    """Least distance of two delays around the turn."""
    if len(turns) < 2:
        return np.inf
    placed = np.sort(turns - np.floor(turns))
    return float(min(np.min(np.diff(placed)), 1.0 + placed[0] - placed[-1]))


def strongest_in(
    left: Complex, inverse: Inverse, bins: int, turns: Real, least_power: float, closest: float
) -> tuple[float, float]:
    """The delay of a grid that tells most of what is left of a channel.

    Parameters
    ----------
    left : ndarray of complex128, shape (N,)
        The channel less its paths.
    inverse : Inverse
        Of the covariance of the noise.
    bins : int
        Delays searched, at least twice as many as tones.
    turns : ndarray, shape (K,)
        Delays of the paths, turns.
    least_power : float
        Of a path; weaker ones are passed over.
    closest : float
        Distance of a path from the others, turns; nearer ones are passed over.

    Returns
    -------
    turns : float
        The delay.
    statistic : float
        Energy that a path there would explain; of noise alone, exponential with mean 1 at every delay.
    """
    correlation = scipy.fft.ifft(inverse.apply(left), bins, norm="forward")
    energy = inverse.atom_energy(bins)
    statistic = np.abs(correlation) ** 2 / energy
    apart = np.arange(bins) / bins - turns[:, None]
    near = np.any(np.abs(apart - np.rint(apart)) < closest, axis=0)
    statistic[near | (statistic < least_power * energy)] = 0.0
    place = int(np.argmax(statistic))
    return place / bins, float(statistic[place])
