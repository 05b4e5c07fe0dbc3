"""Which predicted path is which true one: how much power is explained, and how much is invented."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from raytrace.propagation.paths import PathSet

__all__ = ["Matched", "match_paths"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Matched:
    """Predicted paths matched with true ones.

    Parameters
    ----------
    epoch, anchor : ndarray of int64, shape (N,)
        Channel of each pair.
    power_error_db, delay_error_s : ndarray, shape (N,)
        Predicted less true.
    explained : ndarray, shape (T, K)
        Share of a channel's true power whose paths are matched; NaN where there is none.
    invented : ndarray, shape (T, K)
        Power of predicted paths that match nothing, over the true power; NaN where there is none.
    """

    epoch: NDArray[np.int64]
    anchor: NDArray[np.int64]
    power_error_db: Array
    delay_error_s: Array
    explained: Array
    invented: Array


def match_paths(predicted: PathSet, true: PathSet, within_s: float = 2e-9) -> Matched:
    """Match paths of each channel so that delays agree best in all.

    Parameters
    ----------
    predicted, true : PathSet
        Paths with the same axes (T, K).
    within_s : float
        Delays that differ by more do not match, seconds: about what 400 MHz resolve.
    """
    shape = true.valid.shape[:2]
    explained, invented = np.full(shape, np.nan), np.full(shape, np.nan)
    columns: list[tuple[int, int, float, float]] = []
    for t, k in np.ndindex(shape):
        mine, own = predicted.valid[t, k], true.valid[t, k]
        power = np.abs(true.amplitude[t, k][own]) ** 2
        if not own.any() or not power.sum() > 0.0:
            continue
        guess = np.abs(predicted.amplitude[t, k][mine]) ** 2
        gap = predicted.delay_s[t, k][mine][:, None] - true.delay_s[t, k][own]
        rows, cols = linear_sum_assignment(np.minimum(np.abs(gap), within_s))
        good = np.abs(gap[rows, cols]) < within_s
        rows, cols = rows[good], cols[good]
        explained[t, k] = power[cols].sum() / power.sum()
        invented[t, k] = (guess.sum() - guess[rows].sum()) / power.sum()
        with np.errstate(divide="ignore"):
            error = 10.0 * np.log10(guess[rows] / power[cols])
        columns += [(t, k, float(e), float(gap[i, j])) for e, i, j in zip(error, rows, cols, strict=True)]
    table = np.array(columns).reshape(-1, 4)
    return Matched(
        table[:, 0].astype(np.int64),
        table[:, 1].astype(np.int64),
        table[:, 2],
        table[:, 3],
        explained,
        invented,
    )
