"""Cramer-Rao bounds of path delays with unknown complex gains.

For the model of :mod:`estimator.channel.model` with circular Gaussian noise of variance
``s2`` per tone, eliminating the gains from the Fisher information of delays and gains
leaves, for delays ``x`` in turns,

    F = (2 / s2) Re( conj(g) g^T  o  (-D'' - D'^T D^-1 D') ),

``o`` the elementwise product and ``D, D', D''`` the kernel and its derivatives at all
differences of delays. (P. Stoica and A. Nehorai, "MUSIC, maximum likelihood, and
Cramer-Rao bound", IEEE Trans. ASSP 37 (1989), equation (4.1), with closed-form inner products.)
For one path it is (16) of the paper named in :mod:`estimator.geometry`, see :func:`range_variance`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.channel.model import delay_information, dirichlet
from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["delay_variance", "joint_delay_variance", "range_variance"]

Real = NDArray[np.float64]


def delay_variance(grid: OfdmGrid, snr: ArrayLike) -> Real:
    """Bound on the variance of a single path's delay.

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    snr : array_like
        Signal-to-noise ratio of one tone, ``|g|^2 / s2``, linear, positive.

    Returns
    -------
    ndarray of float64
        ``3 / (2 pi^2 df^2 N (N^2 - 1) snr)``, square seconds, shape of ``snr``.
    """
    n = float(grid.tones)
    information = 2.0 * np.pi**2 * grid.tone_spacing_hz**2 * n * (n**2 - 1.0) / 3.0
    return np.asarray(1.0 / (information * np.asarray(snr, dtype=np.float64)))


def range_variance(grid: OfdmGrid, snr: ArrayLike, two_way: bool = False) -> Real:
    """Bound on the variance of a range, square metres.

    A two-way range (an echo's) is half the length that the delay measures: then it is
    ``3 c^2 / (8 pi^2 B^2 N snr)``, (16) of the paper, up to the factor ``1 - 1/N^2``.

    Parameters
    ----------
    grid, snr
        As in :func:`delay_variance`.
    two_way : bool
        Whether the delay covers the range twice.
    """
    metres_per_second = SPEED_OF_LIGHT_M_S * (0.5 if two_way else 1.0)
    return np.asarray(metres_per_second**2 * delay_variance(grid, snr))


def joint_delay_variance(
    grid: OfdmGrid, delay_s: ArrayLike, gain: ArrayLike, noise_variance: ArrayLike
) -> Real:
    """Bounds on the delays of several paths estimated together.

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    delay_s : array_like, shape (..., K)
        Delays, seconds, all different.
    gain : array_like of complex, shape (..., K)
        Complex gains.
    noise_variance : array_like, shape (...)
        Noise variance per tone.

    Returns
    -------
    ndarray of float64, shape (..., K)
        Variances, square seconds.

    Raises
    ------
    InputError
        If two delays of a channel coincide, so that the bound does not exist.
    """
    turns = np.asarray(delay_s, dtype=np.float64) * grid.tone_spacing_hz
    g = np.asarray(gain, dtype=np.complex128)
    differences = turns[..., :, None] - turns[..., None, :]
    try:
        inverse = np.linalg.inv(delay_information(*dirichlet(differences, grid.tones), g))
    except np.linalg.LinAlgError as error:
        raise InputError("delay_s: expected delays that all differ, got coinciding ones") from error
    scale = np.asarray(noise_variance, dtype=np.float64)[..., None] / (2.0 * grid.tone_spacing_hz**2)
    return np.asarray(scale * np.diagonal(inverse, axis1=-2, axis2=-1))
