"""Correlations of channels with atoms at any delay, interpolated between those on a grid.

A correlation ``z(x) = sum_n y_n exp(j 2 pi n' x)`` over equally spaced tones is a trigonometric polynomial
in ``x``. With a window ``psi`` of W grid points it is

    z(x) = sum_m b_m psi(M x - m),   b the inverse DFT of ``y_n`` over the window's own spectrum,

on a grid of M points, twice as many as tones: a non-uniform FFT. The window is the exponential of a
semicircle of A. Barnett, J. Magland and L. af Klinteberg, "A parallel nonuniform fast Fourier transform
library based on an 'exponential of semicircle' kernel", SIAM J. Sci. Comput. 41 (2019); with W = 14 the
relative error is about 1e-12. Derivatives are those of the polynomials with ``y_n (j 2 pi n')^m``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["Spectra", "SpectrumPlan", "interpolate"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_WIDTH = 14  # grid points of the window
_SHAPE = 2.30 * _WIDTH  # of its exponential, the published choice for a grid of twice the tones
_GRID = 2  # grid points per tone


class Spectra(NamedTuple):
    """One channel prepared by :meth:`SpectrumPlan.of`; compiled functions take it as it is.

    Parameters
    ----------
    values : ndarray of complex128, shape (S, antennas, 3, M + W)
        On the grid, of the channel and of its first two derivatives; the first W columns again at the end.
    half : float
        What tone numbers are off whole numbers: 0 or 1/2.
    """

    values: Complex
    half: float


class SpectrumPlan:
    """The grid and the window for a number of tones.

    Parameters
    ----------
    tones : int
        Number of tones, at least 2.
    """

    def __init__(self, tones: int) -> None:
        middle = tones // 2
        self._bins = scipy.fft.next_fast_len(max(_GRID * tones, 2 * _WIDTH))
        self._half = middle - 0.5 * (tones - 1)
        numbers = np.arange(tones) - middle
        node, weight = np.polynomial.legendre.leggauss(4 * _WIDTH)
        window = weight * np.exp(_SHAPE * (np.sqrt(1.0 - node**2) - 1.0))
        phase = np.pi * _WIDTH / self._bins * np.multiply.outer(numbers, node)
        transform = 0.5 * _WIDTH * np.cos(phase) @ window
        moments = (2j * np.pi * (numbers + self._half)) ** np.arange(3)[:, None]
        self._weights = moments / transform
        self._middle = middle

    def of(self, channel: Complex) -> Spectra:
        """Prepare a channel (S, antennas, tones) for :func:`interpolate`."""
        weighted = channel[:, :, None] * self._weights
        placed = np.zeros((*weighted.shape[:-1], self._bins), dtype=np.complex128)
        placed[..., : weighted.shape[-1] - self._middle] = weighted[..., self._middle :]
        placed[..., -self._middle :] = weighted[..., : self._middle]
        values = scipy.fft.ifft(placed, axis=-1, norm="forward", overwrite_x=True)
        return Spectra(np.concatenate([values, values[..., :_WIDTH]], axis=-1), self._half)


@compiled
def interpolate(spectra: Spectra, turns: float, out: Complex) -> None:
    """Correlation with the atom of a delay, and its first two derivatives by it.

    Parameters
    ----------
    spectra : Spectra
        The channel.
    turns : float
        The delay, turns.
    out : ndarray of complex128, shape (S, antennas, 3)
        Where they go.
    """
    values = spectra.values
    snapshots, antennas, bins = values.shape[0], values.shape[1], values.shape[3] - _WIDTH
    place = (turns - np.floor(turns)) * bins
    first = int(np.floor(place)) - (_WIDTH // 2 - 1)
    window = np.empty(_WIDTH)
    for i in range(_WIDTH):
        t = (place - first - i) * (2.0 / _WIDTH)
        window[i] = np.exp(_SHAPE * (np.sqrt(max(1.0 - t * t, 0.0)) - 1.0))
    if first < 0:
        first += bins
    shift = 2.0 * np.pi * spectra.half * turns
    turn = complex(np.cos(shift), np.sin(shift))
    for s in range(snapshots):
        for a in range(antennas):
            for m in range(3):
                total = 0j
                for i in range(_WIDTH):
                    total += window[i] * values[s, a, m, first + i]
                out[s, a, m] = turn * total
