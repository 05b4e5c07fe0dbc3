"""Separable atoms: a path's response over tones, and over the axes of an antenna array.

A tone's number and an element's place along an axis of a uniform array enter a plane wave's phase
in the same way. So a path is a point ``x`` with one coordinate per axis, in turns from one sample of
the axis to the next, and its atom is the product of what :mod:`estimator.channel.model` has for delays:

    a(x) = prod_d exp(-j 2 pi n'_d x_d),   n'_d = n_d - (N_d - 1) / 2.

Axis 0 are the tones, ``x_0 = tau df``; on an axis of an array with the spacing ``s`` (wavelengths),
``x_d = -s p_d`` for a wave from a direction with the component ``p_d`` along it. Inner products of
atoms are products of Dirichlet kernels, real and in closed form, for one axis, two (ULA) or three (UPA).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.channel.model import ToneBlocks, ToneCorrelator, dirichlet

__all__ = ["AtomKernels", "SeparableAtoms"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class AtomKernels:
    """Inner products of K atoms, and their derivatives by the difference of the coordinates.

    Parameters
    ----------
    kernel : ndarray, shape (..., K, K)
        ``a_k^H a_l``, the Gram matrix.
    slope : ndarray, shape (..., D, K, K)
        First derivatives by ``x_k - x_l``.
    curvature : ndarray, shape (..., D, D, K, K)
        Second derivatives.
    """

    kernel: Real
    slope: Real
    curvature: Real

    def information(self, gain: Complex) -> Real:
        """Fisher information of the coordinates once all complex gains are eliminated, for unit noise.

        For one axis and one snapshot this is (4.1) of P. Stoica and A. Nehorai, "MUSIC, maximum
        likelihood, and Cramer-Rao bound", IEEE Trans. ASSP 37 (1989), with closed-form inner products.

        Parameters
        ----------
        gain : ndarray of complex128, shape (..., S, K)
            Gains of S snapshots.

        Returns
        -------
        ndarray of float64, shape (..., D K, D K)
            ``Re(sum_s conj(g_sk) g_sl) (-G_de - G_d^T G^-1 G_e)_kl``, coordinates slowest; twice this
            over the noise variance is the information.

        Raises
        ------
        numpy.linalg.LinAlgError
            If atoms coincide, so that the Gram matrix is singular.
        """
        *batch, axes, paths, _ = self.slope.shape
        solved = np.linalg.solve(self.kernel[..., None, :, :], self.slope)
        through = np.swapaxes(self.slope, -1, -2)[..., :, None, :, :] @ solved[..., None, :, :, :]
        power = np.real(np.einsum("...sk,...sl->...kl", np.conj(gain), gain))
        blocks = power[..., None, None, :, :] * (-self.curvature - through)
        return np.asarray(np.moveaxis(blocks, -2, -3).reshape(*batch, axes * paths, axes * paths))


class SeparableAtoms:
    """Atoms over tones and antennas: correlations, sums and inner products.

    Parameters
    ----------
    tones : int
        Number of tones, at least 2.
    array_shape : tuple of int
        Elements along each axis of the array; empty for a single antenna.
    """

    def __init__(self, tones: int, array_shape: tuple[int, ...] = ()) -> None:
        self.sizes = np.array([tones, *array_shape])
        self.axes = len(self.sizes)
        self.antennas = int(np.prod(array_shape, dtype=np.int64))
        self.energy = float(tones * self.antennas)
        self._tones = ToneCorrelator(tones)
        centred = np.indices(array_shape).reshape(len(array_shape), self.antennas).astype(np.float64)
        self._places = 2j * np.pi * (centred - 0.5 * (self.sizes[1:, None] - 1.0))  # (D - 1, antennas)

    def split(self, data: Complex) -> ToneBlocks:
        """Prepare data (C, snapshots, antennas, tones) for :meth:`correlate`."""
        return self._tones.split(data)

    def correlate(self, blocks: ToneBlocks, points: Real) -> tuple[Complex, Complex, Complex]:
        """Correlations ``z = a(x)^H y`` and their first and (pure) second derivatives.

        Parameters
        ----------
        blocks : ToneBlocks
            C channels of S snapshots.
        points : ndarray, shape (C, K, D)
            K points of their own for each channel.

        Returns
        -------
        z : ndarray of complex128, shape (C, S, K)
        slope, curvature : ndarray of complex128, shape (C, S, D, K)
        """
        z, slope, curvature = self._tones.correlate(blocks, points[..., 0])
        if self.axes == 1:
            return z[:, :, 0], slope, curvature
        steering = np.exp(self._phase(points))  # (C, antennas, K)
        weights = np.concatenate([np.ones((1, self.antennas)), self._places, self._places**2])
        along = np.einsum("csmk,cmk,wm->wcsk", z, steering, weights)
        delay = np.einsum("wcsmk,cmk->wcsk", np.stack([slope, curvature]), steering)
        first = np.stack([delay[0], *along[1 : self.axes]], axis=2)
        second = np.stack([delay[1], *along[self.axes :]], axis=2)
        return along[0], first, second

    def synthesise(self, points: Real, gain: Complex) -> Complex:
        """Noiseless data ``sum_k g_sk a(x_k)``: gains (C, S, K) to (C, S, antennas, tones)."""
        steering = np.exp(-self._phase(points))
        return self._tones.synthesise(points[..., 0], gain[:, :, None, :] * steering[:, None])

    def kernels(self, difference: Real) -> AtomKernels:
        """Inner products for differences of points, shape (..., K, L, D); see :class:`AtomKernels`."""
        parts = [dirichlet(difference[..., d], int(size)) for d, size in enumerate(self.sizes)]

        def product(*orders: int) -> Real:
            value = parts[0][orders[0]]
            for part, order in zip(parts[1:], orders[1:], strict=True):
                value = value * part[order]
            return value

        unit = np.eye(self.axes, dtype=np.int64)
        slope = np.stack([product(*unit[d]) for d in range(self.axes)], axis=-3)
        curvature = np.stack(
            [
                np.stack([product(*(unit[d] + unit[e])) for e in range(self.axes)], axis=-3)
                for d in range(self.axes)
            ],
            axis=-4,
        )
        return AtomKernels(product(*(0,) * self.axes), slope, curvature)

    def spacing(self, points: Real) -> Real:
        """Distances of points in resolution cells, the largest of all axes, around the turn, (C, K, K)."""
        difference = points[..., :, None, :] - points[..., None, :, :]
        return np.asarray(np.max(np.abs(difference - np.rint(difference)) * self.sizes, axis=-1))

    def _phase(self, points: Real) -> Complex:
        """``j 2 pi n' x`` summed over the array's axes, shape (C, antennas, K)."""
        return np.asarray(np.einsum("dm,ckd->cmk", self._places, points[..., 1:]))
