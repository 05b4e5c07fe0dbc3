"""Figures of merit over runs, each with its Monte-Carlo standard error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.evaluation.metrics import nees_band
from estimator.experiments.room import Room
from estimator.experiments.runs import Score
from estimator.slam.bounds.posterior import Bounds, expected_distance

__all__ = ["CONVERGED_M", "converged_step", "limit_curves", "mean_of", "rms_of", "score_curves", "summarise"]

Array = NDArray[np.float64]

CONVERGED_M = 0.7
"""Mean OSPA below which mapping counts as converged, metres."""
_OSPA_CUTOFF_M = 10.0
_RESAMPLES = 1000


def mean_of(values: ArrayLike) -> tuple[float | None, float | None]:
    """Mean of the finite numbers and its standard error; None where there are too few."""
    x = np.asarray(values, dtype=np.float64)
    x = x[np.isfinite(x)]
    if x.size == 0:
        return None, None
    return float(x.mean()), float(x.std(ddof=1) / np.sqrt(x.size)) if x.size > 1 else None


def rms_of(values: ArrayLike) -> tuple[float | None, float | None]:
    """Root mean square and its standard error, to first order that of the mean square over twice it."""
    square, error = mean_of(np.asarray(values, dtype=np.float64) ** 2)
    if square is None:
        return None, None
    root = float(np.sqrt(square))
    return root, None if error is None or root == 0.0 else 0.5 * error / root


def _median_of(values: ArrayLike) -> tuple[float | None, float | None]:
    """Median, which may be infinite (then None), and its standard error by the bootstrap."""
    x = np.asarray(values, dtype=np.float64)
    if x.size == 0 or not np.isfinite(np.median(x)):
        return None, None
    draws = np.random.default_rng(0).integers(0, x.size, size=(_RESAMPLES, x.size))
    medians = np.median(x[draws], axis=1)
    error = float(medians.std()) if x.size > 1 and np.all(np.isfinite(medians)) else None
    return float(np.median(x)), error


def converged_step(ospa_m: ArrayLike) -> int | None:
    """First step, counted from 1 as in the paper, at which the mean OSPA is below 0.7 m."""
    below = np.asarray(ospa_m) < CONVERGED_M
    return int(np.argmax(below)) + 1 if below.any() else None


def score_curves(scores: Sequence[Score]) -> dict[str, Array]:
    """Means over runs at every step, shape (T,) each: the lines of Fig. 13."""
    derotated = np.array([s.derotated_m for s in scores])
    return {
        "mae_m": np.mean([s.error_m for s in scores], axis=0),
        "derotated_rmse_m": np.sqrt(np.mean(derotated**2, axis=0)),
        "vrp_ospa_m": np.mean([s.ospa_m for s in scores], axis=0),
    }


def limit_curves(limit: Bounds, room: Room) -> dict[str, Array]:
    """What no method can beat, named as by :func:`score_curves`.

    A wall of which nothing is known yet counts as the cut-off, as a missing one does.
    """
    error = expected_distance(limit.wall_covariance_m2, _OSPA_CUTOFF_M)
    due = room.walls_due
    return {
        "mae_m": limit.position_mae_m,
        "derotated_rmse_m": limit.derotated_rmse_m,
        "vrp_ospa_m": np.where(due, error, 0.0).sum(axis=1) / np.maximum(due.sum(axis=1), 1),
    }


def summarise(scores: Sequence[Score], limit: Bounds | None, room: Room) -> dict[str, Any]:
    """Figures of merit of the runs of one case, JSON types only.

    Parameters
    ----------
    scores : sequence of Score
        The runs.
    limit : Bounds or None
        The bound, if there is one.
    room : Room
        The truth.

    Returns
    -------
    dict
        - ``runs``, and ``lost``: how many tracks are beyond use;
        - ``mae_final_m``, ``rmse_final_m``, ``derotated_rmse_final_m``: position errors at the last step,
          lost runs included; ``nees_position_per_dim``: there, with ``nees_band``, the interval of a
          consistent estimator in as many runs (95 %); ``nees_position_per_dim_track``: over all steps;
        - ``vrp_ospa_final_m`` (order 1, cut-off 10 m) at the last step; ``converged_step``: the
          first step, from 1, at which its mean over runs is below 0.7 m;
        - ``new_wall_delay_median``: steps from a new wall's first reflection until it is found; null if
          most runs do not find it; ``walls_false_per_run``: at the last step;
        - ``rotation_rms_rad``: of the whole track about RP;
        - ``seconds_per_run``: processor time;
        - ``limit``: the same of the bound, null without one;

        and with ``_se`` added to the name the Monte-Carlo standard error, null for a single run.
    """
    curves = score_curves(scores)
    figures = {
        "mae_final_m": mean_of([s.error_m[-1] for s in scores]),
        "rmse_final_m": rms_of([s.error_m[-1] for s in scores]),
        "derotated_rmse_final_m": rms_of([s.derotated_m[-1] for s in scores]),
        "nees_position_per_dim": mean_of([s.nees[-1] for s in scores]),
        "nees_position_per_dim_track": mean_of([_mean(s.nees) for s in scores]),
        "vrp_ospa_final_m": mean_of([s.ospa_m[-1] for s in scores]),
        "new_wall_delay_median": _median_of([delay for s in scores for delay in s.wall_delays]),
        "walls_false_per_run": mean_of([s.walls_false for s in scores]),
        "rotation_rms_rad": rms_of([s.rotation_rad for s in scores]),
        "seconds_per_run": mean_of([s.seconds for s in scores]),
    }
    summary: dict[str, Any] = {"runs": len(scores), "lost": sum(s.lost for s in scores)}
    for name, (value, error) in figures.items():
        summary[name], summary[f"{name}_se"] = value, error
    summary["nees_band"] = list(nees_band(2, len(scores)))
    summary["converged_step"] = converged_step(curves["vrp_ospa_m"])
    summary["limit"] = None if limit is None else _limit_of(limit, room)
    return summary


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _limit_of(limit: Bounds, room: Room) -> dict[str, Any]:
    curves = limit_curves(limit, room)
    return {
        "mae_final_m": float(curves["mae_m"][-1]),
        "rmse_final_m": float(limit.position_rmse_m[-1]),
        "derotated_rmse_final_m": float(curves["derotated_rmse_m"][-1]),
        "nees_position_per_dim": 1.0,
        "vrp_ospa_final_m": float(curves["vrp_ospa_m"][-1]),
        "converged_step": converged_step(curves["vrp_ospa_m"]),
        "rotation_rms_rad": float(limit.rotation_std_rad[-1]),
    }
