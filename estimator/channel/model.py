"""The signal model of delays on equally spaced tones: atoms, their kernel, correlations.

A path of delay ``tau`` gives the atom ``a_n = exp(-j 2 pi n' x)`` on tone ``n``, where
``n' = n - (N - 1) / 2`` counts tones from the middle of the band and ``x = tau * spacing``
is the delay in *turns*: the phase it adds from one tone to the next, over ``2 pi``. A CFR is
``y = sum_k g_k a(x_k) + noise`` (see :mod:`estimator.waveform`). Everything that estimation
and bounds need follows from two things:

- the inner products of atoms and of their derivatives, which depend on the difference of
  delays alone and have a closed form, the Dirichlet kernel :func:`dirichlet`;
- the correlations of a CFR with atoms at arbitrary delays, :class:`ToneCorrelator`.

Since the tones are equally spaced and centred, all kernels are real.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.compiled import compiled
from estimator.errors import InputError
from estimator.waveform import OfdmGrid

__all__ = [
    "ToneBlocks",
    "ToneCorrelator",
    "delay_atoms",
    "dirichlet",
    "dirichlet_at",
    "dirichlet_of",
    "tone_atoms",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NEAR = 0.03  # sin(pi x) N below which quotients of sines give way to their series
_BLOCK = 32  # tones per block: close to the root of usual tone numbers, so that both factors are short


def delay_atoms(grid: OfdmGrid, delay_s: ArrayLike) -> Complex:
    """Atoms ``exp(-j 2 pi f tau)`` of given delays.

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    delay_s : array_like, shape (...)
        Delays, seconds.

    Returns
    -------
    ndarray of complex128, shape (..., tones)
    """
    delay = np.asarray(delay_s, dtype=np.float64)
    return np.asarray(np.exp(-2j * np.pi * delay[..., None] * grid.offsets_hz()))


def dirichlet(turns: ArrayLike, tones: int) -> tuple[Real, Real, Real]:
    """The Dirichlet kernel and its first two derivatives.

    ``D(x) = sum_n exp(j 2 pi n' x) = sin(pi N x) / sin(pi x)`` over the centred tone
    numbers ``n'``: the inner product of two atoms whose delays differ by ``x`` turns.

    Parameters
    ----------
    turns : array_like
        Differences of delays in turns, any shape.
    tones : int
        Number of tones ``N``.

    Returns
    -------
    kernel, slope, curvature : ndarray of float64
        ``D``, ``dD/dx`` and ``d2D/dx2`` in the shape of ``turns``.
    """
    x = np.asarray(turns, dtype=np.float64)
    values = np.empty((3, x.size))
    _dirichlet(np.ascontiguousarray(x).ravel(), tones, values)
    return values[0].reshape(x.shape), values[1].reshape(x.shape), values[2].reshape(x.shape)


@compiled
def dirichlet_at(x: float, tones: int) -> tuple[float, float, float]:
    """The Dirichlet kernel and its first two derivatives at one difference; see :func:`dirichlet`."""
    whole = np.rint(x)
    left = x - whole
    turn, step = np.pi * tones * left, np.pi * left
    kernel, slope, curvature = dirichlet_of(
        left, tones, (np.sin(turn), np.cos(turn)), (np.sin(step), np.cos(step))
    )
    if tones % 2 == 0 and whole % 2.0 != 0.0:  # half-integer n': the kernel changes sign from turn to turn
        return -kernel, -slope, -curvature
    return kernel, slope, curvature


@compiled
def dirichlet_of(
    x: float, tones: int, turn: tuple[float, float], step: tuple[float, float]
) -> tuple[float, float, float]:
    """The same where sine and cosine of ``pi tones x`` and of ``pi x`` are known already."""
    n = float(tones)
    if abs(step[0]) * n > _NEAR:
        # D = sin(pi N x) / sin(pi x); the derivatives follow from D sin(pi x) = sin(pi N x).
        over = 1.0 / step[0]
        kernel = turn[0] * over
        slope = np.pi * (n * turn[1] - kernel * step[1]) * over
        curvature = np.pi**2 * (1.0 - n * n) * kernel - 2.0 * np.pi * slope * step[1] * over
        return kernel, slope, curvature
    # there the quotients cancel: Taylor series in the moments of n'
    whole = np.rint(x)
    m2 = n * (n * n - 1.0) / 12.0
    m4 = m2 * (3.0 * n * n - 7.0) / 20.0
    m6 = m2 * (3.0 * n**4 - 18.0 * n * n + 31.0) / 112.0
    w = 2.0 * np.pi
    y = w * (x - whole)
    v = y * y
    kernel = n - v * (m2 / 2.0 - v * (m4 / 24.0 - v * m6 / 720.0))
    slope = -w * y * (m2 - v * (m4 / 6.0 - v * m6 / 120.0))
    curvature = -w * w * (m2 - v * (m4 / 2.0 - v * m6 / 24.0))
    if tones % 2 == 0 and whole % 2.0 != 0.0:
        return -kernel, -slope, -curvature
    return kernel, slope, curvature


@compiled
def _dirichlet(x: Real, tones: int, values: Real) -> None:
    """Fill in the kernel (3, n)."""
    for i in range(x.size):
        values[0, i], values[1, i], values[2, i] = dirichlet_at(x[i], tones)


def tone_atoms(turns: Real, tones: int) -> Complex:
    """Atoms (K, N) of delays (K,) in turns."""
    number = np.arange(tones) - 0.5 * (tones - 1)
    return np.asarray(np.exp(-2j * np.pi * turns[:, None] * number))


@dataclass(frozen=True, eq=False)
class ToneBlocks:
    """CFRs prepared by :meth:`ToneCorrelator.split`.

    Parameters
    ----------
    values : ndarray of complex128, shape (C, ..., 3 * blocks, 32)
        The tones of each CFR weighted with ``(j 2 pi n')^m``, m = 0, 1, 2, in blocks of 32.
    """

    values: Complex


class ToneCorrelator:
    """Correlates CFRs with atoms at arbitrary delays, and sums atoms, by a factorisation.

    With the tones in blocks of 32, ``n' = 32 p + q``, an atom is the outer product of
    ``exp(-j 2 pi 32 p x)`` and ``exp(-j 2 pi q x)``: for 819 tones, 58 exponentials rather than
    819, and small matrix products in place of long sums. Nothing is approximated.

    Parameters
    ----------
    tones : int
        Number of tones, at least 2.
    """

    def __init__(self, tones: int) -> None:
        if tones < 2:
            raise InputError(f"tones: expected at least 2, got {tones}")
        self.tones = tones
        self._blocks = -(-tones // _BLOCK)
        numbers = np.arange(tones) - 0.5 * (tones - 1)
        self._weights = (2j * np.pi * numbers) ** np.arange(3)[:, None]
        self._outer = 2j * np.pi * (_BLOCK * np.arange(self._blocks) - 0.5 * (tones - 1))
        self._inner = 2j * np.pi * np.arange(_BLOCK)

    def split(self, cfr: Complex) -> ToneBlocks:
        """Prepare CFRs, shape (C, ..., tones), for :meth:`correlate`."""
        padded = np.zeros((*cfr.shape[:-1], 3, self._blocks * _BLOCK), dtype=np.complex128)
        padded[..., : self.tones] = cfr[..., None, :] * self._weights
        return ToneBlocks(padded.reshape(*cfr.shape[:-1], 3 * self._blocks, _BLOCK))

    def correlate(self, blocks: ToneBlocks, turns: Real) -> tuple[Complex, Complex, Complex]:
        """Correlation ``z(x) = sum_n y_n exp(j 2 pi n' x)`` and its first two derivatives in ``x``.

        Parameters
        ----------
        blocks : ToneBlocks
            C channels of one CFR, or of several (...): antennas, snapshots.
        turns : ndarray, shape (C, K)
            Delays in turns, K of their own for each channel.

        Returns
        -------
        z, slope, curvature : ndarray of complex128, shape (C, ..., K)
        """
        lanes = blocks.values.shape[1:-2]
        own = (len(turns), *(1,) * len(lanes))
        inner = np.exp(self._inner[:, None] * turns[:, None, :]).reshape(*own, _BLOCK, -1)
        outer = np.exp(self._outer[:, None] * turns[:, None, :])
        shape = (len(turns), *lanes, 3, self._blocks, turns.shape[1])
        partial = (blocks.values @ inner).reshape(shape)
        sums = np.einsum("c...mpk,cpk->mc...k", partial, outer)
        return sums[0], sums[1], sums[2]

    def synthesise(self, turns: Real, gain: Complex) -> Complex:
        """Noiseless CFRs ``sum_k g_k a(x_k)``.

        Parameters
        ----------
        turns : ndarray, shape (C, K)
            Delays in turns.
        gain : ndarray of complex128, shape (C, ..., K)
            Gains, of each of a channel's CFRs.

        Returns
        -------
        ndarray of complex128, shape (C, ..., tones)
        """
        own = (len(turns), *(1,) * (gain.ndim - 2))
        outer = np.exp(-self._outer[:, None] * turns[:, None, :]).reshape(*own, self._blocks, -1)
        inner = np.exp(-self._inner * turns[:, :, None]).reshape(*own, -1, _BLOCK)
        padded = ((outer * gain[..., None, :]) @ inner).reshape(*gain.shape[:-1], self._blocks * _BLOCK)
        return np.asarray(padded[..., : self.tones])
