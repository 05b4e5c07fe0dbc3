"""Predicted channels against true ones that the prediction has not seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytrace.prediction.channels import Channels
from raytrace.prediction.matching import match_paths

__all__ = ["NEAR_M", "SilentFloor", "score_channels", "score_powers"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NEAR_M = 2.0
"""Positions farther than this from the mapped track are what a map is for."""


@dataclass(frozen=True)
class SilentFloor:
    """What counts where nothing is predicted.

    Parameters
    ----------
    gain_db : float
        A channel in which nothing is predicted has this gain: below what a receiver of 26 dBm EIRP hears.
    """

    gain_db: float = -160.0


def score_channels(
    predicted: Channels, true: Channels, far: Mask, floor: SilentFloor | None = None
) -> dict[str, Any]:
    """Figures of merit of a prediction; channels without any true path do not count.

    Parameters
    ----------
    predicted, true : Channels
        Channels at the same positions, of the same anchors in the same order.
    far : ndarray of bool, shape (T,)
        Positions that are far from the mapped track.
    floor : SilentFloor, optional
        What counts where nothing is predicted.

    Returns
    -------
    dict
        JSON types: ``channels``; pairs of median and 90th percentile of absolute errors ``power_db``,
        ``wideband_db``, ``path_power_db``, ``path_delay_ns``, ``delay_spread_ns``; means ``explained``,
        ``invented``,
        ``line_of_sight_right``; the first two again for the far positions, ``far``.
    """
    floor = floor or SilentFloor()
    there = true.power > 0.0
    matched = match_paths(predicted.paths, true.paths)
    spread = np.abs(predicted.delay_spread_s - true.delay_spread_s)[there]
    right = (predicted.line_of_sight == true.line_of_sight)[there]
    power = _error(predicted.power, true.power, floor)
    wide = _error(predicted.wideband_power, true.wideband_power, floor)
    away = there & far[:, None]
    return {
        "channels": int(there.sum()),
        "power_db": _pair(power[there]),
        "wideband_db": _pair(wide[there]),
        "path_power_db": _pair(np.abs(matched.power_error_db)),
        "path_delay_ns": _pair(1e9 * np.abs(matched.delay_error_s)),
        "delay_spread_ns": _pair(1e9 * spread[np.isfinite(spread)]),
        "explained": _mean(matched.explained[there]),
        "invented": _mean(matched.invented[there]),
        "line_of_sight_right": _mean(right.astype(np.float64)),
        "far": {
            "channels": int(away.sum()),
            "power_db": _pair(power[away]),
            "wideband_db": _pair(wide[away]),
        },
    }


def score_powers(powers_db: Mapping[str, Array], true: Channels, far: Mask) -> dict[str, Any]:
    """Median and 90th percentile of the absolute error of powers (T, K), of all and of far positions."""
    there = true.power > 0.0
    own = 10.0 * np.log10(np.where(there, true.power, 1.0))
    scores = {}
    for name, power in powers_db.items():
        error = np.abs(power - own)
        known = there & np.isfinite(error)
        scores[name] = {
            "power_db": _pair(error[known]),
            "far": {"power_db": _pair(error[known & far[:, None]])},
        }
    return scores


def _error(predicted: Array, true: Array, floor: SilentFloor) -> Array:
    """Absolute difference (T, K), dB."""
    least = 10.0 ** (floor.gain_db / 10.0)
    return np.asarray(np.abs(10.0 * np.log10(np.maximum(predicted, least) / np.maximum(true, least))))


def _pair(values: Array) -> list[float] | None:
    """Median and 90th percentile; None of nothing."""
    return [float(v) for v in np.percentile(values, [50.0, 90.0])] if values.size else None


def _mean(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None
