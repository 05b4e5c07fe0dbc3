"""Separable atoms: a path's response over tones, and over the axes of an antenna array.

A tone's number and an element's place along an axis of a uniform array enter a plane wave's phase
in the same way. So a path is a point ``x`` with one coordinate per axis, in turns from one sample of
the axis to the next, and its atom is the product of what :mod:`estimator.channel.model` has for delays:

    a(x) = prod_d exp(-j 2 pi n'_d x_d),   n'_d = n_d - (N_d - 1) / 2.

Axis 0 are the tones, ``x_0 = tau df``; on an axis of an array with the spacing ``s`` (wavelengths),
``x_d = -s p_d`` for a wave from a direction with the component ``p_d`` along it. Inner products of
atoms are products of Dirichlet kernels, real and in closed form, for one axis, two (ULA) or three (UPA).

Paths interact through these inner products and data enter through correlations
(:mod:`estimator.channel.interpolation`), so that a refinement of K paths does not cost K times the number of
samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.channel.interpolation import Spectra, interpolate
from estimator.channel.linear import solve_forward
from estimator.channel.model import dirichlet_at, dirichlet_of
from estimator.compiled import compiled

__all__ = [
    "Atoms",
    "Kernels",
    "atoms_of",
    "correlate",
    "information",
    "inner_products",
    "kernel_at",
    "spacing",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Atoms(NamedTuple):
    """What the samples are; compiled functions take it as it is.

    Parameters
    ----------
    sizes : ndarray of int64, shape (D,)
        Tones, and elements along each axis of the array.
    places : ndarray, shape (antennas, D - 1)
        Numbers of the elements along each axis, from the middle of the array.
    energy : float
        Squared norm of an atom: the number of samples.
    """

    sizes: NDArray[np.int64]
    places: Real
    energy: float


class Kernels(NamedTuple):
    """Inner products of K atoms, and their derivatives by the difference of the coordinates.

    Parameters
    ----------
    kernel : ndarray, shape (K, K)
        ``a_k^H a_l``, the Gram matrix.
    slope : ndarray, shape (D, K, K)
        First derivatives by ``x_k - x_l``.
    curvature : ndarray, shape (D, D, K, K)
        Second derivatives.
    """

    kernel: Real
    slope: Real
    curvature: Real


def atoms_of(tones: int, array_shape: tuple[int, ...] = ()) -> Atoms:
    """Atoms over tones and the elements of an array (``array_shape`` is empty for a single antenna)."""
    antennas = int(np.prod(array_shape, dtype=np.int64))
    numbers = np.indices(array_shape).reshape(len(array_shape), antennas).T.astype(np.float64)
    places = numbers - 0.5 * (np.array(array_shape, dtype=np.float64) - 1.0)
    sizes = np.array([tones, *array_shape], dtype=np.int64)
    return Atoms(sizes, np.ascontiguousarray(places), float(tones * antennas))


@compiled
def kernel_at(sizes: NDArray[np.int64], one: Real, other: Real, slope: Real, curvature: Real) -> float:
    """Inner product of the atoms of two points (D,), and its derivatives by their difference.

    Parameters
    ----------
    sizes : ndarray of int64, shape (D,)
        Samples along each axis.
    one, other : ndarray, shape (D,)
        Points, turns.
    slope, curvature : ndarray, shape (D,) and (D, D)
        Where the derivatives go.
    """
    axes = sizes.size
    value, first, second = dirichlet_at(one[0] - other[0], sizes[0])
    slope[0], curvature[0, 0] = first, second
    product = value
    for d in range(1, axes):
        value, first, second = dirichlet_at(one[d] - other[d], sizes[d])
        for e in range(d):
            curvature[e, d] = curvature[d, e] = slope[e] * first
            for g in range(e + 1):
                curvature[e, g] *= value
                curvature[g, e] = curvature[e, g]
            slope[e] *= value
        slope[d], curvature[d, d] = product * first, product * second
        product *= value
    return product


@compiled
def inner_products(sizes: NDArray[np.int64], points: Real) -> Kernels:
    """Inner products of the atoms of points (K, D)."""
    paths, axes = points.shape
    kernel = np.empty((paths, paths))
    slope, curvature = np.empty((axes, paths, paths)), np.empty((axes, axes, paths, paths))
    if axes == 1:
        _inner_products_of_delays(sizes[0], points, kernel, slope[0], curvature[0, 0])
        return Kernels(kernel, slope, curvature)
    first, second = np.empty(axes), np.empty((axes, axes))
    for k in range(paths):
        for j in range(k, paths):
            kernel[k, j] = kernel[j, k] = kernel_at(sizes, points[k], points[j], first, second)
            for d in range(axes):
                slope[d, k, j], slope[d, j, k] = first[d], -first[d]
                for e in range(axes):
                    curvature[d, e, k, j] = curvature[d, e, j, k] = second[d, e]
    return Kernels(kernel, slope, curvature)


@compiled
def _inner_products_of_delays(tones: int, points: Real, kernel: Real, slope: Real, curvature: Real) -> None:
    """The same of delays alone: sines of differences come from those of the delays."""
    paths = points.shape[0]
    trig = np.empty((paths, 4))
    for k in range(paths):
        turn, step = np.pi * tones * points[k, 0], np.pi * points[k, 0]
        trig[k, 0], trig[k, 1], trig[k, 2], trig[k, 3] = (
            np.sin(turn),
            np.cos(turn),
            np.sin(step),
            np.cos(step),
        )
    for k in range(paths):
        sn, cn, s1, c1 = trig[k, 0], trig[k, 1], trig[k, 2], trig[k, 3]
        for j in range(k, paths):
            un, vn, u1, v1 = trig[j, 0], trig[j, 1], trig[j, 2], trig[j, 3]
            turn2, step2 = (sn * vn - cn * un, cn * vn + sn * un), (s1 * v1 - c1 * u1, c1 * v1 + s1 * u1)
            value, first, second = dirichlet_of(points[k, 0] - points[j, 0], tones, turn2, step2)
            kernel[k, j] = kernel[j, k] = value
            slope[k, j], slope[j, k] = first, -first
            curvature[k, j] = curvature[j, k] = second


@compiled
def information(kernels: Kernels, upper: Real, gain: Complex) -> Real:
    """Fisher information (D K, D K) of the coordinates once all complex gains are eliminated, for unit noise.

    Coordinates come slowest. For one axis and one snapshot this is (4.1) of P. Stoica and A. Nehorai, "MUSIC,
    maximum likelihood, and Cramer-Rao bound", IEEE Trans. ASSP 37 (1989), with closed-form inner products.

    Parameters
    ----------
    kernels : Kernels
        Of K points.
    upper : ndarray, shape (K, K)
        Cholesky's factor of ``kernels.kernel``.
    gain : ndarray of complex128, shape (S, K)
        Gains of S snapshots.
    """
    axes, paths = kernels.slope.shape[:2]
    power = np.zeros((paths, paths))
    for s in range(gain.shape[0]):
        for k in range(paths):
            for j in range(paths):
                power[k, j] += gain[s, k].real * gain[s, j].real + gain[s, k].imag * gain[s, j].imag
    solved = kernels.slope.copy()
    for d in range(axes):
        solve_forward(upper, solved[d])
    matrix = np.empty((axes * paths, axes * paths))
    through = np.empty((paths, paths))
    for d in range(axes):
        for e in range(d + 1):
            for k in range(paths):
                for j in range(paths):
                    through[k, j] = -kernels.curvature[d, e, k, j]
            for i in range(paths):
                for k in range(paths):
                    factor = solved[d, i, k]
                    for j in range(paths):
                        through[k, j] -= factor * solved[e, i, j]
            for k in range(paths):
                for j in range(paths):
                    value = power[k, j] * through[k, j]
                    matrix[d * paths + k, e * paths + j] = value
                    matrix[e * paths + j, d * paths + k] = value
    return matrix


@compiled
def correlate(atoms: Atoms, spectra: Spectra, point: Real, work: Complex, out: Complex) -> None:
    """Correlations ``z = a(x)^H y`` of S snapshots, and their first and (pure) second derivatives.

    Parameters
    ----------
    atoms : Atoms
        The samples.
    spectra : Spectra
        The channel.
    point : ndarray, shape (D,)
        Where, turns.
    work : ndarray of complex128, shape (S, antennas, 3)
        Overwritten.
    out : ndarray of complex128, shape (S, 1 + 2 D)
        Where they go: correlation, first derivatives, second derivatives.
    """
    interpolate(spectra, point[0], work)
    axes = point.size
    out[:] = 0.0
    for s in range(out.shape[0]):
        for a in range(atoms.places.shape[0]):
            phase = 0.0
            for d in range(1, axes):
                phase += atoms.places[a, d - 1] * point[d]
            phase *= 2.0 * np.pi
            steering = complex(np.cos(phase), np.sin(phase))
            value = work[s, a, 0] * steering
            out[s, 0] += value
            out[s, 1] += work[s, a, 1] * steering
            out[s, 1 + axes] += work[s, a, 2] * steering
            for d in range(1, axes):
                turn = 2.0 * np.pi * atoms.places[a, d - 1]
                out[s, 1 + d] += complex(-turn * value.imag, turn * value.real)
                out[s, 1 + axes + d] -= turn * turn * value


@compiled
def spacing(sizes: NDArray[np.int64], one: Real, other: Real) -> float:
    """Distance of two points in resolution cells, the largest of all axes, around the turn."""
    largest = 0.0
    for d in range(sizes.size):
        gap = one[d] - other[d]
        largest = max(largest, abs(gap - np.rint(gap)) * sizes[d])
    return largest
