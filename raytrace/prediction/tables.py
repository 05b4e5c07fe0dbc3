"""Predicted channels as rows and lists, for files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raytrace.prediction.channels import Channels

__all__ = ["channel_rows", "path_lists"]

Array = NDArray[np.float64]


def channel_rows(
    channels: Channels, anchors: Sequence[str], time_s: Array, position_m: Array
) -> list[dict[str, Any]]:
    """One row for each position and anchor: where, power, delay spread, whether there is a line of sight.

    Parameters
    ----------
    channels : Channels
        T positions and K anchors.
    anchors : sequence of str
        Their names.
    time_s, position_m : ndarray, shapes (T,) and (T, 2) or more
        The track.

    Returns
    -------
    list of dict
        JSON types; powers are dB over the EIRP, null where nothing arrives.
    """
    rows = []
    for t, k in np.ndindex(channels.power.shape):
        spread = channels.delay_spread_s[t, k]
        rows.append(
            {
                "time_s": float(time_s[t]),
                "x_m": float(position_m[t, 0]),
                "y_m": float(position_m[t, 1]),
                "anchor": anchors[k],
                "paths": int(channels.paths.valid[t, k].sum()),
                "power_db": _decibels(float(channels.power[t, k])),
                "wideband_power_db": _decibels(float(channels.wideband_power[t, k])),
                "delay_spread_s": float(spread) if np.isfinite(spread) else None,
                "line_of_sight": bool(channels.line_of_sight[t, k]),
            }
        )
    return rows


def path_lists(channels: Channels, anchors: Sequence[str]) -> list[dict[str, Any]]:
    """Every path: position (a row of the track), anchor, delay, gain, arrival, and its surfaces."""
    paths = channels.paths.flat()
    return [
        {
            "position": int(paths.epoch[i]),
            "anchor": anchors[int(paths.anchor[i])],
            "delay_s": float(paths.delay_s[i]),
            "gain_db": _decibels(float(np.abs(paths.amplitude[i]) ** 2)),
            "arrival_azimuth_rad": float(paths.arrival_azimuth_rad[i]),
            "surfaces": [int(wall) for wall in paths.walls[i] if wall >= 0],
        }
        for i in range(len(paths))
    ]


def _decibels(power: float) -> float | None:
    return float(10.0 * np.log10(power)) if power > 0.0 else None
