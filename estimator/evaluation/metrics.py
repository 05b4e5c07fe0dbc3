"""Figures of merit: OSPA and its mean, MAE, RMSE, the error with rotation removed, NEES.

Conventions: estimates and truths are metres in the same frame and end in an axis of
length 2 (x, y). The reference point (RP) is the origin of that frame, which is what
makes a rotation about the origin the one motion of a map that passive delays cannot
see: errors are therefore worth reporting with and without it.

References
----------
D. Schuhmacher, B.-T. Vo, B.-N. Vo, "A consistent metric for performance evaluation of
multi-object filters", IEEE Trans. Signal Process. 56 (2008), for OSPA;
Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
Navigation" (2001), section 5.4, for NEES.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError

__all__ = [
    "best_rotation",
    "derotated",
    "distances",
    "gaps",
    "match",
    "match_of",
    "mean_absolute_error",
    "mospa",
    "nees",
    "nees_band",
    "ospa",
    "ospa_of",
    "root_mean_square_error",
]

Array = NDArray[np.float64]


def _points(name: str, value: ArrayLike) -> Array:
    points = np.asarray(value, dtype=np.float64)
    if points.ndim < 1 or points.shape[-1] != 2:
        raise InputError(f"{name}: expected shape (..., 2), got {points.shape}")
    if not np.all(np.isfinite(points)):
        raise InputError(f"{name}: expected finite numbers, got {points[~np.isfinite(points)][0]}")
    return points


def _set(name: str, value: ArrayLike) -> Array:
    points = np.asarray(value, dtype=np.float64)
    if points.size == 0:
        return np.zeros((0, 2))
    if points.ndim != 2:
        raise InputError(f"{name}: expected shape (n, 2), got {points.shape}")
    return _points(name, points)


def _pairs(estimate: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    e, t = _points("estimate", estimate), _points("truth", truth)
    if e.shape != t.shape:
        raise InputError(f"estimate: expected the truth's shape {t.shape}, got {e.shape}")
    return e, t


def distances(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Euclidean distances of pairs of points.

    Parameters
    ----------
    estimate, truth : array_like, shape (..., 2)
        Points, metres; equal shapes.

    Returns
    -------
    ndarray, shape (...)
        Metres.

    Raises
    ------
    InputError
        If the shapes differ, do not end in 2, or a number is not finite.
    """
    e, t = _pairs(estimate, truth)
    return np.asarray(np.linalg.norm(e - t, axis=-1))


def mean_absolute_error(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Mean of :func:`distances`, metres."""
    return float(np.mean(distances(estimate, truth)))


def root_mean_square_error(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Root of the mean square of :func:`distances`, metres."""
    return float(np.sqrt(np.mean(distances(estimate, truth) ** 2)))


def best_rotation(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Angle by which an estimate is rotated about RP, in the sense of least squares.

    The angle ``phi`` minimises ``sum_i |e_i - R(phi) t_i|^2`` over the last axis of points;
    with ``.`` and ``x`` the dot and cross products in the plane,

        phi = atan2(sum_i t_i x e_i, sum_i t_i . e_i).

    One angle for a whole track comes from shape (T, 2); one angle per epoch, from the
    ``n`` points known at each of them, comes from shape (T, n, 2).

    Parameters
    ----------
    estimate, truth : array_like, shape (..., n, 2)
        Points, metres, relative to RP.

    Returns
    -------
    ndarray, shape (...)
        Radians in (-pi, pi], counter-clockwise from the truth to the estimate; 0 where
        the points say nothing (all at RP).
    """
    e, t = _pairs(estimate, truth)
    if e.ndim < 2:
        raise InputError(f"estimate: expected shape (..., n, 2), got {e.shape}")
    cross = np.sum(t[..., 0] * e[..., 1] - t[..., 1] * e[..., 0], axis=-1)
    return np.asarray(np.arctan2(cross, np.sum(t * e, axis=(-2, -1))))


def derotated(estimate: ArrayLike, angle_rad: ArrayLike) -> Array:
    """The estimate turned back by the angle of :func:`best_rotation`.

    Parameters
    ----------
    estimate : array_like, shape (..., n, 2)
        Points, metres, relative to RP.
    angle_rad : array_like, shape (...)
        Radians.

    Returns
    -------
    ndarray, shape (..., n, 2)
    """
    e = _points("estimate", estimate)
    c, s = np.cos(angle_rad)[..., None], np.sin(angle_rad)[..., None]
    return np.stack([c * e[..., 0] + s * e[..., 1], c * e[..., 1] - s * e[..., 0]], axis=-1)


def nees(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Normalised estimation error squared per dimension, ``e' P^-1 e / n``.

    Its mean is 1 for an estimator whose covariance is the truth about its errors, more
    for an over-confident one, less for a timid one.

    Parameters
    ----------
    error : array_like, shape (..., n)
        Estimate minus truth.
    covariance : array_like, shape (..., n, n)
        Claimed covariances, positive definite.

    Returns
    -------
    ndarray, shape (...)

    Raises
    ------
    InputError
        If shapes do not fit or a covariance is not positive definite.
    """
    e, p = np.asarray(error, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    if e.ndim < 1 or p.shape != (*e.shape, e.shape[-1]):
        raise InputError(f"covariance: expected shape (..., n, n) for errors {e.shape}, got {p.shape}")
    try:
        factor = np.linalg.cholesky(p)
    except np.linalg.LinAlgError as error_:
        raise InputError("covariance: expected positive definite matrices, got one that is not") from error_
    white = np.linalg.solve(factor, e[..., None])[..., 0]
    return np.asarray(np.mean(white**2, axis=-1))


def nees_band(dimensions: int, samples: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided interval of the mean of :func:`nees` for a consistent estimator.

    Parameters
    ----------
    dimensions : int
        Dimension ``n`` of the error.
    samples : int
        Number of *independent* errors averaged. Epochs of one run are far from
        independent: a run counts as about one.
    probability : float
        Probability of the interval.

    Returns
    -------
    tuple of float
        Quantiles of chi-square with ``n * samples`` degrees of freedom, divided by them.
    """
    from scipy.special import gammainccinv, gammaincinv

    half = 0.5 * dimensions * samples  # a quantile of chi-square is twice one of the gamma distribution
    tail = 0.5 * (1.0 - probability)
    return float(gammaincinv(half, tail) / half), float(gammainccinv(half, tail) / half)


def match(estimate: ArrayLike, truth: ArrayLike, gate_m: float) -> list[tuple[int, int]]:
    """One-to-one assignment of estimates to truths within a gate.

    The assignment has the least sum of ``min(distance, gate)``, an unassigned pair
    costing the gate (OSPA's assignment with order 1).

    Parameters
    ----------
    estimate, truth : array_like, shapes (m, 2) and (n, 2)
        Points, metres.
    gate_m : float
        Pairs farther apart than this are not matched, metres.

    Returns
    -------
    list of (int, int)
        Pairs (row of estimate, row of truth), ascending.
    """
    rows, columns = match_of(gaps(_set("estimate", estimate), _set("truth", truth)), gate_m)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def match_of(gap_m: Array, gate_m: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of :func:`match`, ascending, from the distances of all pairs, shape (m, n)."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(np.minimum(gap_m, gate_m))
    near = gap_m[rows, columns] <= gate_m
    return rows[near], columns[near]


def ospa(estimate: ArrayLike, truth: ArrayLike, cutoff_m: float = 10.0, order: float = 1.0) -> float:
    """Optimal sub-pattern assignment distance of two sets of points.

    For sets of sizes ``m <= n``: ``(1/n (min sum_i min(d_i, c)^p + c^p (n - m)))^(1/p)``.

    Parameters
    ----------
    estimate, truth : array_like, shapes (m, 2) and (n, 2)
        Points, metres; either may be empty.
    cutoff_m : float
        Cut-off ``c``, metres: the price of a missing or a surplus point.
    order : float
        Order ``p``, at least 1.

    Returns
    -------
    float
        Metres, from 0 (also for two empty sets) to ``cutoff_m``.

    Raises
    ------
    InputError
        If the cut-off is not positive or the order is below 1.
    """
    if not cutoff_m > 0.0:
        raise InputError(f"cutoff_m: expected a positive number, got {cutoff_m}")
    if not order >= 1.0:
        raise InputError(f"order: expected at least 1, got {order}")
    return ospa_of(gaps(_set("estimate", estimate), _set("truth", truth)), cutoff_m, order)


def ospa_of(gap_m: Array, cutoff_m: float, order: float = 1.0) -> float:
    """OSPA distance from the distances of all pairs, see :func:`ospa`.

    Parameters
    ----------
    gap_m : ndarray, shape (m, n)
        Distances of estimates from truths, metres.
    cutoff_m, order
        As in :func:`ospa`.

    Returns
    -------
    float
        Metres.
    """
    from scipy.optimize import linear_sum_assignment

    larger, smaller = max(gap_m.shape), min(gap_m.shape)
    if larger == 0:
        return 0.0
    cost = np.minimum(gap_m, cutoff_m) ** order
    surplus = (larger - smaller) * cutoff_m**order
    return float(((cost[linear_sum_assignment(cost)].sum() + surplus) / larger) ** (1.0 / order))


def mospa(
    estimates: Iterable[ArrayLike],
    truths: Iterable[ArrayLike],
    cutoff_m: float = 10.0,
    order: float = 1.0,
) -> float:
    """Mean OSPA of several pairs of sets: of runs, or of the epochs of a run.

    Parameters
    ----------
    estimates, truths : iterable of array_like, shapes (m, 2) and (n, 2)
        Sets of points, metres; equally many of both, at least one.
    cutoff_m, order
        As in :func:`ospa`.

    Returns
    -------
    float
        Metres.

    Raises
    ------
    InputError
        If there are no sets, or not as many estimates as truths.
    """
    pairs = list(zip_longest(estimates, truths))
    if not pairs or any(one is None for pair in pairs for one in pair):
        raise InputError("estimates: expected as many sets as truths, and at least one")
    return float(np.mean([ospa(estimate, truth, cutoff_m, order) for estimate, truth in pairs]))


def gaps(estimate_m: Array, truth_m: Array) -> Array:
    """Distances of all pairs of points, shapes (..., m, 2) and (n, 2) to (..., m, n)."""
    offset = estimate_m[..., :, None, :] - truth_m
    return np.hypot(offset[..., 0], offset[..., 1])
