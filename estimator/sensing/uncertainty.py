"""The VRP and its covariance as published: pairs of RSPs averaged, (17)-(26) and Corollary 1.

RSP 1 is paired with each of the others, every pair gives a VRP (Theorem 2), and the M - 1
solutions are averaged, (25). The published covariance (26) is not the truth about that estimate,
for two reasons: x and y of one RSP have one range error in common, where cov{w} = diag{...} has
them independent; and all pairs share RSP 1, where (26) adds their covariances as if they did not.
``covariance="full"`` propagates the M independent range errors through the same estimate
instead. Neither makes the estimate efficient: see :mod:`estimator.sensing.linefit` for one that is.

Equation numbers refer to the paper named in :mod:`estimator.sensing.ranges`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.measurements import GaussianVrp
from estimator.sensing.surfaces import pair_solution, reflection_points

__all__ = ["CovarianceModel", "average_pairs", "checked_ranges", "paired_vrp"]

Array = NDArray[np.float64]
CovarianceModel = Literal["published", "full"]


def checked_ranges(
    distance_m: ArrayLike, range_std_m: ArrayLike, azimuth_rad: ArrayLike, least: int = 2
) -> tuple[Array, Array, Array]:
    """Ranges, standard deviations and directions of RSPs as arrays of one shape (..., M).

    Raises
    ------
    InputError
        If there are fewer than ``least`` RSPs, or a number is not finite, or a distance or standard
        deviation is not positive.
    """
    distance, std, azimuth = np.broadcast_arrays(
        *(np.asarray(value, dtype=np.float64) for value in (distance_m, range_std_m, azimuth_rad))
    )
    if distance.ndim < 1 or distance.shape[-1] < least:
        raise InputError(
            f"distance_m: expected at least {least} ranges on the last axis, got {distance.shape}"
        )
    for name, value in (("distance_m", distance), ("range_std_m", std)):
        if not np.all((value > 0.0) & (value < np.inf)):
            bad = value[~((value > 0.0) & (value < np.inf))][0]
            raise InputError(f"{name}: expected positive finite numbers, got {bad}")
    if not np.all(np.isfinite(azimuth)):
        raise InputError(f"azimuth_rad: expected finite numbers, got {azimuth[~np.isfinite(azimuth)][0]}")
    return distance, std, azimuth


def average_pairs(
    distance_m: ArrayLike,
    range_std_m: ArrayLike,
    azimuth_rad: ArrayLike,
    covariance: CovarianceModel = "published",
) -> tuple[Array, Array]:
    """VRPs relative to RP (where the agent stands), and their covariances; many sweeps at once.

    Parameters
    ----------
    distance_m : array_like, shape (..., M)
        Measured distances of the RSPs of one wall, metres.
    range_std_m : array_like, shape (..., M)
        Their standard deviations, metres.
    azimuth_rad : array_like, shape (..., M)
        Directions of the beams, radians.
    covariance : {"published", "full"}
        (26), or the covariance that this estimate has to first order.

    Returns
    -------
    mean : ndarray, shape (..., 2)
        (25), metres.
    covariance : ndarray, shape (..., 2, 2)
        Square metres.

    Raises
    ------
    InputError
        If ranges are fewer than two, not positive, or directions coincide.
    ConfigurationError
        If the covariance model is unknown.
    """
    if covariance not in ("published", "full"):
        raise ConfigurationError(f"covariance: expected 'published' or 'full', got {covariance!r}")
    distance, std, azimuth = checked_ranges(distance_m, range_std_m, azimuth_rad)
    points = reflection_points(distance, azimuth)  # (8)
    pairs = pair_solution(points[..., :1, :], points[..., 1:, :])  # (24)
    count = distance.shape[-1] - 1
    mean = np.mean(pairs.mean_m, axis=-2)  # (25)
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    if covariance == "published":
        first, rest = std[..., :1] ** 2, std[..., 1:] ** 2
        variance = np.stack(  # (18): of x1, x2, y1, y2 of every pair
            np.broadcast_arrays(
                first * cosine[..., :1] ** 2,
                rest * cosine[..., 1:] ** 2,
                first * sine[..., :1] ** 2,
                rest * sine[..., 1:] ** 2,
            ),
            axis=-1,
        )
        spread = np.einsum("...mwi,...mw,...mwj->...ij", pairs.gradient, variance, pairs.gradient)
        return mean, spread / count**2  # (26)
    q = pairs.gradient / count
    by_first = np.sum(q[..., 0, :] * cosine[..., :1, None] + q[..., 2, :] * sine[..., :1, None], axis=-2)
    by_rest = q[..., 1, :] * cosine[..., 1:, None] + q[..., 3, :] * sine[..., 1:, None]
    by_range = np.concatenate([by_first[..., None, :], by_rest], axis=-2) * std[..., None]  # (..., M, 2)
    return mean, np.asarray(np.swapaxes(by_range, -1, -2) @ by_range)


def paired_vrp(
    distance_m: ArrayLike,
    range_std_m: ArrayLike,
    azimuth_rad: ArrayLike,
    covariance: CovarianceModel = "published",
) -> GaussianVrp:
    """One wall as published, from the ranges of its RSPs (M,); see :func:`average_pairs`."""
    return GaussianVrp(*average_pairs(distance_m, range_std_m, azimuth_rad, covariance))
