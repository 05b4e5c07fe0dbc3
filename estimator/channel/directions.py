"""Azimuth and elevation from a direction's components along the axes of an array.

A wave from azimuth ``az`` (from the boresight) and elevation ``el`` has, along a ULA, the component
``p = cos(el) sin(az)``: read as an azimuth in front, at elevation 0. An upright UPA adds ``sin(el)``, which
gives both angles, in front. A lying UPA has ``p = cos(el) (cos(az), sin(az))``: its direction in the
plane is the azimuth, all around, and its length the cosine of the elevation, whose sign is not seen and
which is hardly known near the horizon, where the cosine is flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import AntennaArray, UniformLinearArray

__all__ = ["Directions", "directions"]

Real = NDArray[np.float64]

_LEAST_COSINE = 1e-3
_VAGUE_RAD = 0.5  # an elevation known no better than this is not known


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions of arrival of n paths.

    Parameters
    ----------
    azimuth_rad, azimuth_std_rad : ndarray, shape (n,)
        Azimuths in the array's frame and their standard deviations, radians. Of an array that does
        not tell front from back, those in front.
    elevation_rad, elevation_std_rad : ndarray, shape (n,)
        Elevations (of a lying array, without their sign) and their standard deviations, radians; NaN
        where they are not observable.
    """

    azimuth_rad: Real
    azimuth_std_rad: Real
    elevation_rad: Real
    elevation_std_rad: Real


def directions(array: AntennaArray, projection: Real, covariance: Real) -> Directions:
    """Angles and their standard deviations to first order.

    Parameters
    ----------
    array : AntennaArray
        The array, with D axes.
    projection : ndarray, shape (n, D)
        Components of the directions along its axes.
    covariance : ndarray, shape (n, D, D)
        Their covariances.

    Returns
    -------
    Directions
    """
    if isinstance(array, UniformLinearArray):
        sine = np.clip(projection[:, 0], -1.0, 1.0)
        cosine = np.maximum(np.sqrt(1.0 - sine**2), _LEAST_COSINE)
        azimuth, azimuth_row = np.arcsin(sine), (1.0 / cosine)[:, None]
        elevation, elevation_row = np.full(len(sine), np.nan), np.zeros((len(sine), 1))
    elif not array.lying:
        rise, along = np.clip(projection[:, 0], -1.0, 1.0), projection[:, 1]
        level = np.maximum(np.sqrt(1.0 - rise**2), _LEAST_COSINE)  # cos(el)
        sine = np.clip(along / level, -1.0, 1.0)
        cosine = np.maximum(np.sqrt(1.0 - sine**2), _LEAST_COSINE)
        azimuth, elevation = np.arcsin(sine), np.arcsin(rise)
        azimuth_row = np.stack([sine * rise / level**2, 1.0 / level], axis=1) / cosine[:, None]
        elevation_row = np.stack([1.0 / level, np.zeros_like(level)], axis=1)
    else:
        length = np.maximum(np.linalg.norm(projection, axis=1), _LEAST_COSINE)
        azimuth = np.arctan2(projection[:, 1], projection[:, 0])
        azimuth_row = np.stack([-projection[:, 1], projection[:, 0]], axis=1) / length[:, None] ** 2
        elevation = np.arccos(np.minimum(length, 1.0))
        sine = np.maximum(np.sin(elevation), _LEAST_COSINE)
        elevation_row = -projection / (length * sine)[:, None]
    azimuth_std = _std(azimuth_row, covariance)
    elevation_std = np.where(np.isfinite(elevation), _std(elevation_row, covariance), np.nan)
    known = elevation_std < _VAGUE_RAD
    return Directions(
        np.angle(np.exp(1j * (azimuth + array.boresight_rad))),
        azimuth_std,
        np.where(known, elevation, np.nan),
        np.where(known, elevation_std, np.nan),
    )


def _std(row: Real, covariance: Real) -> Real:
    """Standard deviations of ``row . p``."""
    return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", row, covariance, row)))
