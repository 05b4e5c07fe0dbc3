"""The scatter of ranges: how far each lies from the line through its neighbours in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["range_scatter"]

Array = NDArray[np.float64]
_GAP_S = 0.25  # neighbours are at least so far apart: errors that are closer are alike
_LEAST_M = 0.01  # no ranging is better, and many devices round to it
_NORMAL = 1.4826  # standard deviations of a normal law in its median absolute value
_FEWEST = 5  # ranges that tell a scatter


def range_scatter(time_s: Array, anchor: NDArray[np.int64], range_m: Array, anchors: int) -> Array:
    """Standard deviations (K,) of the ranges of each anchor, metres.

    Of three ranges in a row the middle one would lie on the line through the others if the agent went
    straight on and ranges were exact; the median of how far it does not is robust to turns and to gross
    errors. An anchor with too few ranges has the median of the others.

    Parameters
    ----------
    time_s, anchor, range_m
        As in :class:`estimator.readers.range_log.RangeLog`.
    anchors : int
        Number of anchors K.
    """
    std = np.full(anchors, np.nan)
    for k in range(anchors):
        own = np.flatnonzero((anchor == k) & np.isfinite(range_m))
        own = own[np.argsort(time_s[own], kind="stable")]
        apart = _apart(time_s[own])
        t, x = time_s[own[apart]], range_m[own[apart]]
        if len(t) < _FEWEST:
            continue
        share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
        off = x[1:-1] - (1.0 - share) * x[:-2] - share * x[2:]
        off /= np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
        std[k] = max(_NORMAL * float(np.median(np.abs(off))), _LEAST_M)
    if np.isnan(std).all():
        return np.full(anchors, 10.0 * _LEAST_M)
    return np.where(np.isnan(std), np.nanmedian(std), std)


def _apart(time_s: Array) -> list[int]:
    """Of ascending times those that are far enough from the one before."""
    kept = [0] if len(time_s) else []
    for i in range(1, len(time_s)):
        if time_s[i] - time_s[kept[-1]] >= _GAP_S - 1e-9:
            kept.append(i)
    return kept
