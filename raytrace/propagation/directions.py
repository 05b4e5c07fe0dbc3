"""Directions in the plan frame: azimuth and elevation, unit vectors, and the basis of a field's two parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["angles_of", "directions_of", "spherical_basis"]

Array = NDArray[np.float64]


def angles_of(vectors: Array) -> tuple[Array, Array]:
    """Azimuth in (-pi, pi] and elevation above the horizontal of vectors (..., 3), radians."""
    azimuth = np.arctan2(vectors[..., 1], vectors[..., 0])
    elevation = np.arctan2(vectors[..., 2], np.hypot(vectors[..., 0], vectors[..., 1]))
    return azimuth, elevation


def directions_of(azimuth_rad: Array, elevation_rad: Array) -> Array:
    """Unit vectors (..., 3) of azimuths and elevations, radians; the inverse of :func:`angles_of`."""
    level = np.cos(elevation_rad)
    return np.stack(
        [level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)], axis=-1
    )


def spherical_basis(directions: Array) -> Array:
    """Zenith and azimuth unit vectors of directions (..., 3), shape (..., 2, 3)."""
    azimuth, elevation = angles_of(directions)
    c, s = np.cos(azimuth), np.sin(azimuth)
    rise, level = np.sin(elevation), np.cos(elevation)
    zenith = np.stack([rise * c, rise * s, -level], axis=-1)
    return np.stack([zenith, np.stack([-s, c, np.zeros_like(c)], axis=-1)], axis=-2)
