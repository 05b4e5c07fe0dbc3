"""SLAM on measured sets beside plain methods: one method, one table of settings, no set's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.evaluation.metrics import nees
from estimator.experiments.measured.plain import kalman_track, least_squares_track
from estimator.experiments.measured.run import MeasuredRun
from estimator.experiments.measured.sets import measured_runs
from estimator.geometry import rotation_matrix
from estimator.slam.run import run_slam

__all__ = ["METHOD", "compare", "measured_table"]

Array = NDArray[np.float64]
METHOD = "va"  # anchors are known, walls are not
_LOST_SHARE = 0.1  # a run is lost if it is off by more than this share of the true track's extent
_LOST_M = 1.0  # or more, where it is small
_OFFSETS_S = np.linspace(-0.5, 0.5, 101)  # of clocks, that are tried


def compare(folder: Path, method: str = METHOD) -> dict[str, dict[str, Any]]:
    """Run every set of a folder, and plain methods beside.

    Parameters
    ----------
    folder : Path
        Where the sets lie (:mod:`estimator.experiments.measured.sets`).
    method : str
        The method (:mod:`estimator.slam.methods`).

    Returns
    -------
    dict
        For each run, JSON types only: ``method``; ``mae_m``, ``rmse_m``: errors of the position over all
        epochs with truth; ``nees_per_dim``: mean of NEES / 2; ``lost``: whether the RMSE is beyond use;
        ``flagged``: whether the run itself says at its end that it may not be relied on;
        ``false_features``: walls found, of which ranges of lines of sight tell none; ``ekf_mae_m``,
        ``least_squares_mae_m``: of plain methods (null where there is none).

    Raises
    ------
    FileFormatError
        If there is no known set, or a file of one is damaged.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for run in measured_runs(Path(folder)):
        found.setdefault(run.key, []).append(_compared(run, method))
    return {key: _together(each) for key, each in found.items()}


def _together(each: list[dict[str, Any]]) -> dict[str, Any]:
    """Several runs as one: medians of errors, the sum of false features, whatever most are."""
    if len(each) == 1:
        return each[0]
    whole = {"method": each[0]["method"]}
    for name in each[0]:
        values = [one[name] for one in each if one[name] is not None]
        if name == "false_features":
            whole[name] = sum(values)
        elif name in ("lost", "flagged"):
            whole[name] = 2 * sum(values) > len(values)
        elif name != "method":
            whole[name] = float(np.median(values)) if values else None
    return whole


def _compared(run: MeasuredRun, method: str) -> dict[str, Any]:
    measurements, plainly = run.measurements, run.plain or run.measurements
    start, plain_start = (np.array(one.settings["start_m"]) for one in (measurements, plainly))
    time = np.array([epoch.time_s for epoch in measurements.epochs])
    turn = rotation_matrix(run.heading_rad)
    plain = least_squares_track(plainly) @ turn.T + plain_start
    truth = run.truth.at(time + (_clock_offset(run, time, plain) if run.clocks_differ else 0.0))
    result = run_slam(measurements, method)
    known = np.isfinite(truth).all(axis=1)
    error = result.agent_mean[:, :2] @ turn.T + start - truth
    covariance = turn @ result.agent_covariance[:, :2, :2] @ turn.T
    distance = np.linalg.norm(error[known], axis=1)
    rmse = float(np.sqrt(np.mean(distance**2)))
    extent = float(np.linalg.norm(np.ptp(truth[known], axis=0)))
    return {
        "method": method,
        "mae_m": float(distance.mean()),
        "rmse_m": rmse,
        "nees_per_dim": float(nees(error[known], covariance[known]).mean()),
        "lost": bool(rmse > max(_LOST_M, _LOST_SHARE * extent)),
        "flagged": bool(result.flagged[-1]),
        "false_features": int(result.wall_valid[-1].sum()),
        "ekf_mae_m": _mean_error(kalman_track(plainly) @ turn.T + plain_start, truth),
        "least_squares_mae_m": _mean_error(plain, truth),
    }


def _clock_offset(run: MeasuredRun, time_s: Array, plain: Array) -> float:
    """By how much the truth's clock is ahead: where the places of least squares scatter least about it."""

    def scatter(offset: float) -> float:
        gap = plain - run.truth.at(time_s + offset)
        gap = gap[np.isfinite(gap).all(axis=1)]
        return float(np.median(np.linalg.norm(gap - np.median(gap, axis=0), axis=1)))

    return float(min(_OFFSETS_S, key=scatter))


def _mean_error(track: Array, truth: Array) -> float | None:
    distance = np.linalg.norm(track - truth, axis=1)
    distance = distance[np.isfinite(distance)]
    return float(distance.mean()) if distance.size else None


def measured_table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The comparison as a table for people."""
    head = ("run", "method", "MAE m", "RMSE m", "NEES", "lost", "false", "EKF m", "least squares m")
    rows: list[Sequence[str]] = [head]
    for key, one in found.items():
        rows.append(
            (
                key,
                one["method"],
                f"{one['mae_m']:.3f}",
                f"{one['rmse_m']:.3f}",
                f"{one['nees_per_dim']:.2f}",
                "lost" if one["lost"] else "no",
                str(one["false_features"]),
                *(
                    "-" if one[name] is None else f"{one[name]:.3f}"
                    for name in ("ekf_mae_m", "least_squares_mae_m")
                ),
            )
        )
    width = [max(len(row[c]) for row in rows) for c in range(len(head))]
    return (
        "\n".join(
            "  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows
        )
        + "\n"
    )
