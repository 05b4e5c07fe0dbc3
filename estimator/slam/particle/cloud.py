"""Clouds of equally weighted particles: resampling, moments, independent pairing.

Particles are kept as arrays (d, N), coordinate by coordinate, in single precision:
a hundredth of a millimetre at a hundred metres, far below their driving noise, at half
the memory and a fraction of the time. Sums over particles are taken in double. A cloud is never
changed: what moves it makes a new one, so that states may share clouds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.compiled import compiled
from estimator.slam.particle.exponential import exp_negative

__all__ = [
    "Cloud",
    "gaussian_cloud",
    "moments_of",
    "moved",
    "normals",
    "resample",
    "systematic",
    "total_variance",
]

Cloud = NDArray[np.float32]
Real = NDArray[np.float64]

_PIECE = 2048  # particles worked on at a time: what fits the processor's nearest cache
_LANES = 32  # partial sums: a fixed order of addition that vector units can follow


def systematic(
    log_weight: NDArray[np.floating], rng: np.random.Generator, count: int | None = None
) -> NDArray[np.int32]:
    """Systematic resampling.

    Parent ``i`` is drawn ``floor(N w_i)`` or ``ceil(N w_i)`` times, ``N w_i`` times on average.

    Parameters
    ----------
    log_weight : ndarray, shape (P,)
        Log weights up to a constant, at least one of them finite. More than 55 below the largest is as good
        as minus infinity.
    rng : Generator
        Source of the one random number.
    count : int, optional
        Number of draws, N; by default as many as there are weights.

    Returns
    -------
    ndarray of int32, shape (N,)
        Indices of the parents, ascending.
    """
    relative = np.asarray(log_weight - log_weight.max(), dtype=np.float32)
    return _parents(relative, rng.random(), len(relative) if count is None else count)


def resample(cloud: Cloud, log_weight: NDArray[np.floating], rng: np.random.Generator) -> Cloud:
    """A cloud (d, N) of equal weights, in cyclic order from a random place.

    The random start unties the particles of different nodes, which are paired by their
    index: belief propagation takes their beliefs as independent.
    """
    index = systematic(log_weight, rng)
    return _gather(cloud, index, int(rng.integers(len(index))))


def normals(count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Standard normal numbers (count,), in pairs from uniform ones (Box and Muller).

    Several times as fast as one by one. Uniform numbers of 24 bits give none beyond 5.8.
    """
    half = (count + 1) // 2
    radius = np.log(np.float32(1.0) - rng.random(half, dtype=np.float32))
    radius *= np.float32(-2.0)
    np.sqrt(radius, out=radius)
    angle = rng.random(half, dtype=np.float32)
    angle *= np.float32(2.0 * np.pi)
    out = np.empty((2, half), np.float32)
    np.multiply(radius, np.cos(angle), out=out[0])
    np.multiply(radius, np.sin(angle), out=out[1])
    return out.ravel()[:count]


def gaussian_cloud(mean: ArrayLike, covariance: ArrayLike, count: int, rng: np.random.Generator) -> Cloud:
    """Draws (d, N) from a Gaussian; the covariance may be singular."""
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    varied = values > 1e-12 * values.max()  # the others are zero up to rounding
    root = (vectors[:, varied] * np.sqrt(values[varied])).astype(np.float32)
    noise = normals(root.shape[1] * count, rng).reshape(root.shape[1], count)
    cloud = np.empty((len(values), count), np.float32)
    cloud[...] = np.asarray(mean, dtype=np.float32)[:, None]
    _add_product(root, noise, cloud)
    return cloud


def moved(cloud: Cloud, matrix: Real, covariance: Real, rng: np.random.Generator) -> Cloud:
    """Particles (d, N) times a matrix (d, d), plus Gaussian noise of the covariance."""
    out = gaussian_cloud(np.zeros(len(cloud)), covariance, cloud.shape[1], rng)
    _add_product(matrix.astype(np.float32), cloud, out)
    return out


def moments_of(cloud: Cloud) -> tuple[Real, Real]:
    """Mean (d,) and covariance (d, d) of a cloud (d, N): the MMSE estimates (34), (37)."""
    mean, covariance = np.empty(len(cloud)), np.empty((len(cloud), len(cloud)))
    _moments(cloud, mean, covariance)
    return mean, covariance


def total_variance(cloud: Cloud) -> tuple[Real, float]:
    """Mean (d,) of a cloud (d, N), and the trace of its covariance."""
    mean = np.empty(len(cloud))
    return mean, _variance(cloud, mean)


@compiled
def _parents(log_weight: NDArray[np.float32], offset: float, count: int) -> NDArray[np.int32]:
    """Parent of draw ``i``: where the cumulative weight, of ``count`` in all, passes ``i + offset``."""
    size = log_weight.size
    weight, reached, drawn = np.empty(_PIECE, np.float32), np.empty(_PIECE), np.empty(_PIECE, np.uint32)
    partial, total = np.zeros(_LANES), 0.0
    whole = size - size % _LANES
    for first in range(0, whole, _LANES):
        for j in range(_LANES):
            partial[j] += exp_negative(log_weight[first + j])
    for p in range(whole, size):
        partial[p - whole] += exp_negative(log_weight[p])
    for j in range(_LANES):
        total += partial[j]
    parent, place = np.zeros(count + 1, np.int32), np.uint32(0)
    scale, so_far = count / total, 0.0
    for first in range(0, size, _PIECE):
        piece = min(_PIECE, size - first)
        for p in range(piece):
            weight[p] = exp_negative(log_weight[first + p])
        for p in range(piece):
            so_far += weight[p]
            reached[p] = so_far
        for p in range(piece):
            drawn[p] = np.uint32(min(np.ceil(reached[p] * scale - offset), count))
        for p in range(piece):
            parent[place] = first + p  # replaced by the next one if this one is not drawn
            place = drawn[p]
    last = np.int32(0)
    for i in range(count):
        last = max(last, parent[i])
        parent[i] = last
    return parent[:count]


@compiled
def _add_product(matrix: Cloud, cloud: Cloud, out: Cloud) -> None:
    """Add ``matrix`` (d, r) times ``cloud`` (r, N) to ``out`` (d, N)."""
    for d in range(out.shape[0]):
        for e in range(cloud.shape[0]):
            factor = matrix[d, e]
            if factor != 0.0:
                for n in range(out.shape[1]):
                    out[d, n] += factor * cloud[e, n]


@compiled
def _gather(cloud: Cloud, index: NDArray[np.int32], start: int) -> Cloud:
    """Particles ``index``, the first of them at place ``start``, cyclically."""
    count = index.size
    out = np.empty((cloud.shape[0], count), cloud.dtype)
    for d in range(cloud.shape[0]):
        for i in range(count - start):
            out[d, start + i] = cloud[d, index[i]]
        for i in range(count - start, count):
            out[d, start + i - count] = cloud[d, index[i]]
    return out


@compiled
def _variance(cloud: Cloud, mean: Real) -> float:
    """Fill in the mean, and return the trace of the covariance: in one pass, about the first particle."""
    axes, count = cloud.shape
    whole, trace = count - count % _LANES, 0.0
    first, second = np.empty(_LANES), np.empty(_LANES)
    for d in range(axes):
        first[:], second[:], about = 0.0, 0.0, np.float64(cloud[d, 0])
        for place in range(0, whole, _LANES):
            for j in range(_LANES):
                off = cloud[d, place + j] - about
                first[j] += off
                second[j] += off * off
        for i in range(whole, count):
            off = cloud[d, i] - about
            first[i - whole] += off
            second[i - whole] += off * off
        one, two = 0.0, 0.0
        for j in range(_LANES):
            one, two = one + first[j], two + second[j]
        mean[d] = about + one / count
        trace += two / count - (one / count) ** 2
    return trace


@compiled
def _moments(cloud: Cloud, mean: Real, covariance: Real) -> None:
    """Fill in mean and covariance."""
    axes, count = cloud.shape
    whole = count - count % _LANES
    partial = np.empty(_LANES)
    for d in range(axes):
        partial[:] = 0.0
        for first in range(0, whole, _LANES):
            for j in range(_LANES):
                partial[j] += cloud[d, first + j]
        for i in range(whole, count):
            partial[i - whole] += cloud[d, i]
        mean[d] = 0.0
        for j in range(_LANES):
            mean[d] += partial[j]
        mean[d] /= count
    for d in range(axes):
        for e in range(d + 1):
            partial[:] = 0.0
            for first in range(0, whole, _LANES):
                for j in range(_LANES):
                    partial[j] += (cloud[d, first + j] - mean[d]) * (cloud[e, first + j] - mean[e])
            for i in range(whole, count):
                partial[i - whole] += (cloud[d, i] - mean[d]) * (cloud[e, i] - mean[e])
            total = 0.0
            for j in range(_LANES):
                total += partial[j]
            covariance[d, e] = covariance[e, d] = total / count
