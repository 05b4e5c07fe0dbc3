"""Powers without a map: free space, and what was measured nearby. What a twin has to be better than."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.waveform import free_space_loss_db

__all__ = ["INTERPOLATIONS", "interpolated_db"]

Array = NDArray[np.float64]
INTERPOLATIONS = ("free space", "nearest neighbour", "inverse distance", "log-distance")
_NEIGHBOURS = 8
_NEAREST_M = 0.05  # neighbours nearer than this count as that near


def interpolated_db(
    method: str,
    positions_m: Array,
    anchors_m: Array,
    measured_at_m: Array,
    measured_db: Array,
    carrier_hz: float,
) -> Array:
    """Power at positions by one of :data:`INTERPOLATIONS`.

    ``inverse distance`` weighs the eight nearest measurements; ``log-distance`` fits a line over the
    logarithm of
    the distance from the anchor and adds the residuals of the eight nearest.

    Parameters
    ----------
    method : str
        Which.
    positions_m : ndarray, shape (T, 2)
        Where the power is asked.
    anchors_m : ndarray, shape (K, 2)
        The anchors.
    measured_at_m : ndarray, shape (M, 2)
        Where powers were measured.
    measured_db : ndarray, shape (M, K)
        Which, dB over the EIRP; NaN where none was.
    carrier_hz : float
        Carrier frequency.

    Returns
    -------
    ndarray, shape (T, K)
        NaN of anchors without measurements.

    Raises
    ------
    InputError
        If the method is unknown.
    """
    if method not in INTERPOLATIONS:
        raise InputError(f"method: expected one of {', '.join(INTERPOLATIONS)}, got {method!r}")
    result = np.full((len(positions_m), len(anchors_m)), np.nan)
    for k, anchor in enumerate(anchors_m):
        away = np.maximum(np.linalg.norm(positions_m - anchor, axis=1), 0.1)
        if method == "free space":
            result[:, k] = -free_space_loss_db(away, carrier_hz)
            continue
        known = np.isfinite(measured_db[:, k])
        if not known.any():
            continue
        at, power = measured_at_m[known], measured_db[known, k]
        gap = np.maximum(np.linalg.norm(positions_m[:, None] - at, axis=-1), _NEAREST_M)
        if method == "nearest neighbour":
            result[:, k] = power[gap.argmin(axis=1)]
            continue
        if method == "inverse distance":
            result[:, k] = _weighted(gap, power)
            continue
        distance = np.log10(np.maximum(np.linalg.norm(at - anchor, axis=1), 0.1))
        slope, level = np.polyfit(distance, power, 1) if len(power) > 1 else (0.0, power[0])
        trend = level + slope * np.log10(away)
        result[:, k] = trend + _weighted(gap, power - level - slope * distance)
    return result


def _weighted(gap: Array, values: Array) -> Array:
    """Means of the nearest values (M,), by inverse distance (T, M)."""
    nearest = np.argsort(gap, axis=1, kind="stable")[:, :_NEIGHBOURS]
    weight = 1.0 / np.take_along_axis(gap, nearest, axis=1)
    return np.asarray(np.sum(weight * values[nearest], axis=1) / weight.sum(axis=1))
