"""Cramer-Rao bounds of delays and directions with unknown complex gains.

For the atoms of :mod:`estimator.channel.atoms` with circular Gaussian noise of variance
``s2`` per tone and antenna, eliminating the gains from the Fisher information of points and gains
leaves, for points ``x`` in turns,

    F = (2 / s2) Re( conj(g) g^T  o  (-G'' - G'^T G^-1 G') ),

``o`` the elementwise product and ``G, G', G''`` the inner products of the atoms and their derivatives.
(P. Stoica and A. Nehorai, "MUSIC, maximum likelihood, and
Cramer-Rao bound", IEEE Trans. ASSP 37 (1989), equation (4.1), with closed-form inner products.)
For the delay of one path it is (16) of the paper named in :mod:`estimator.geometry`, see
:func:`range_variance`; delays and directions of a path alone do not disturb each other, those of
several paths do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.arrays import AntennaArray
from estimator.channel.atoms import information, inner_products
from estimator.channel.linear import factorise, invert
from estimator.compiled import compiled
from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = [
    "delay_direction_covariance",
    "delay_variance",
    "joint_delay_variance",
    "point_covariance",
    "range_variance",
]

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
    delay = np.asarray(delay_s, dtype=np.float64)
    g = np.asarray(gain, dtype=np.complex128)
    points = (delay * grid.tone_spacing_hz)[..., None]
    covariance = point_covariance(np.array([grid.tones]), points, g[..., None, :], noise_variance)
    return np.asarray(covariance[..., 0, 0] / grid.tone_spacing_hz**2)


def point_covariance(
    sizes: NDArray[np.int64], points: Real, gain: NDArray[np.complex128], noise_variance: ArrayLike
) -> Real:
    """Bounds on points estimated together, their gains unknown.

    Parameters
    ----------
    sizes : ndarray of int64, shape (D,)
        Tones, and elements along each axis of the array.
    points : ndarray, shape (..., K, D)
        Points in turns, all different.
    gain : ndarray of complex128, shape (..., S, K)
        Gains in S snapshots.
    noise_variance : array_like, shape (...)
        Noise variance per tone and antenna.

    Returns
    -------
    ndarray of float64, shape (..., K, D, D)
        Covariance of the coordinates of each point, square turns.

    Raises
    ------
    InputError
        If two points of a channel coincide, so that the bound does not exist.
    """
    *batch, paths, axes = points.shape
    many = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, paths, axes)
    gains = np.ascontiguousarray(np.broadcast_to(gain, (*batch, *gain.shape[-2:])), dtype=np.complex128)
    own = np.empty((*many.shape, axes))
    if not _own_blocks(sizes, many, gains.reshape(len(many), -1, paths), own):
        raise InputError("delay_s: expected delays that all differ, got coinciding ones")
    scale = 0.5 * np.asarray(noise_variance, dtype=np.float64)[..., None, None, None]
    return np.asarray(scale * own.reshape(*batch, paths, axes, axes))


@compiled
def _own_blocks(sizes: NDArray[np.int64], points: Real, gain: NDArray[np.complex128], own: Real) -> bool:
    """Fill in the blocks (C, K, D, D) of the inverse information; whether all of it could be inverted."""
    channels, paths, axes = points.shape
    for c in range(channels):
        kernels = inner_products(sizes, points[c])
        upper = kernels.kernel.copy()
        if not factorise(upper):
            return False
        inverse = information(kernels, upper, gain[c])
        if not invert(inverse):
            return False
        for k in range(paths):
            for d in range(axes):
                for e in range(axes):
                    own[c, k, d, e] = inverse[d * paths + k, e * paths + k]
    return True


def delay_direction_covariance(
    grid: OfdmGrid,
    array: AntennaArray,
    delay_s: ArrayLike,
    projection: ArrayLike,
    gain: ArrayLike,
    noise_variance: ArrayLike,
) -> Real:
    """Bounds on delays and directions of several paths estimated together.

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    array : AntennaArray
        The array, with D - 1 axes.
    delay_s : array_like, shape (..., K)
        Delays, seconds.
    projection : array_like, shape (..., K, D - 1)
        Components of the directions along the array's axes (``array.projection``).
    gain : array_like of complex, shape (..., K) or (..., S, K)
        Complex gains of one snapshot or of S; give the axis S if the paths have leading axes.
    noise_variance : array_like, shape (...)
        Noise variance per tone and antenna.

    Returns
    -------
    ndarray of float64, shape (..., K, D, D)
        Covariance of (delay, components) of each path: seconds, and sines.

    Raises
    ------
    InputError
        If two paths coincide, so that the bound does not exist.
    """
    delay = np.asarray(delay_s, dtype=np.float64)
    g = np.asarray(gain, dtype=np.complex128)
    g = g[..., None, :] if g.ndim == delay.ndim else g
    scale = np.array([grid.tone_spacing_hz] + [-spacing for spacing in array.spacings])
    direction = np.asarray(projection, dtype=np.float64)
    points = np.concatenate([delay[..., None], direction], axis=-1) * scale
    sizes = np.array([grid.tones, *array.shape], dtype=np.int64)
    return np.asarray(point_covariance(sizes, points, g, noise_variance) / np.outer(scale, scale))
