"""The start: where the first ranges of known anchors meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError

__all__ = ["Start", "start_of"]

Array = NDArray[np.float64]
_WINDOW_S = 5.0  # the first ranges: within this time of the first one
_FEWEST = 3  # anchors that tell a place in the plane
_GRID = 41  # places on a side that are tried first
_APART = 4.0  # a second place that fits nearly as well, in standard deviations of the first
_NEARLY = 4.0  # as well: the sum of squares is at most so much larger


class Start(NamedTuple):
    """Where the agent starts, metres, and how well that is known, per axis."""

    place_m: Array
    std_m: float


def start_of(
    time_s: Array,
    anchor: NDArray[np.int64],
    range_m: Array,
    std_m: Array,
    anchors_m: Array,
    model: Mapping[str, Any],
) -> Start:
    """The place that the first ranges fit best, robustly, with the error that biases and motion may leave.

    Parameters
    ----------
    time_s, anchor, range_m, std_m : ndarray, shape (N,)
        The ranges.
    anchors_m : ndarray, shape (K, 2)
        The anchors.
    model : mapping
        Settings: ``clock_bias_std_m``, ``range_scale_std``, ``velocity_std_m_s``.

    Raises
    ------
    InputError
        If fewer than three anchors are heard, or two places fit: then the start has to be told.
    """
    from scipy.optimize import least_squares

    rows = _first(time_s, anchor, range_m)
    heard = np.unique(anchor[rows])
    if len(heard) < _FEWEST:
        raise InputError(
            f"start: expected ranges of {_FEWEST} anchors within {_WINDOW_S:g} s of the first, got those of "
            f"{len(heard)}; say where the agent starts"
        )
    places, length = anchors_m[anchor[rows]], range_m[rows]
    moved = model["velocity_std_m_s"] * (time_s[rows] - time_s[rows].min())
    variance = (
        std_m[rows] ** 2
        + model["clock_bias_std_m"] ** 2
        + (model["range_scale_std"] * length) ** 2
        + moved**2
    )

    def gap(place: Array) -> Array:
        return np.asarray((length - np.linalg.norm(place - places, axis=1)) / np.sqrt(variance))

    reach = float(np.max(length))
    low, high = anchors_m.min(axis=0) - reach, anchors_m.max(axis=0) + reach
    grid = np.stack(np.meshgrid(*np.linspace(low, high, _GRID).T), axis=-1).reshape(-1, 2)
    cost = np.array([np.minimum(gap(place) ** 2, 9.0).sum() for place in grid])
    fits = [least_squares(gap, grid[i], loss="soft_l1") for i in np.argsort(cost)[:12]]
    best = min(fits, key=lambda fit: fit.cost)
    jacobian = np.asarray(best.jac, dtype=np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    std = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1] * max(1.0, 2.0 * best.cost / len(rows))))
    for fit in fits:
        if fit.cost < best.cost + _NEARLY and np.linalg.norm(fit.x - best.x) > max(_APART * std, 0.1 * reach):
            raise InputError(
                f"start: expected one place where the first ranges meet, got {best.x.round(2).tolist()} and "
                f"{fit.x.round(2).tolist()}; say where the agent starts"
            )
    return Start(np.asarray(best.x, dtype=np.float64), std)


def _first(time_s: Array, anchor: NDArray[np.int64], range_m: Array) -> NDArray[np.int64]:
    """The first range of each anchor that is heard soon enough."""
    good = np.flatnonzero(np.isfinite(range_m) & (range_m > 0.0))
    order = good[np.argsort(time_s[good], kind="stable")]
    order = order[time_s[order] <= time_s[order[0]] + _WINDOW_S] if order.size else order
    _, first = np.unique(anchor[order], return_index=True)
    return np.asarray(order[np.sort(first)], dtype=np.int64)
