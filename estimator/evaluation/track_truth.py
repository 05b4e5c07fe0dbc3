"""A result against a true track alone, as others have it: absolute and relative errors, aligned or not.

Alignments are those that tools for trajectories know: none but the start, the rotation about it, or the rigid
motion of the plane (SE(2)) that fits best in the sense of least squares. Nothing is scaled.

References
----------
J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, for ATE and RPE;
S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE Trans.
Pattern Anal. Mach. Intell. 13 (1991).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.evaluation.metrics import best_rotation, derotated, distances, nees
from estimator.geometry import rotation_matrix
from estimator.result import SlamResult

__all__ = ["ALIGNMENTS", "evaluate_track"]

Array = NDArray[np.float64]
ALIGNMENTS = ("start", "rotation", "se2")
_RELATIVE_S = 1.0  # relative errors are those of motions of this long
_LEAST_EPOCHS = 2  # with truth


def evaluate_track(
    result: SlamResult,
    track_m: ArrayLike,
    start_m: ArrayLike = (0.0, 0.0),
    align: str = "start",
    anchors_m: ArrayLike | None = None,
) -> dict[str, Any]:
    """Compare a result with a true track.

    Parameters
    ----------
    result : SlamResult
        Estimates of one run.
    track_m : array_like, shape (T, 2)
        True places at the result's epochs, metres; NaN where unknown: such epochs do not count.
    start_m : array_like, shape (2,)
        The estimator's origin in the frame of the truth, metres.
    align : str
        What is taken off before errors are told: ``start`` (nothing more), ``rotation`` (about the origin),
        ``se2``.
    anchors_m : array_like, shape (K, 2), optional
        True places of the anchors, metres.

    Returns
    -------
    dict
        JSON types only: ``epochs`` that count; ``align``; ``position_mae_m``, ``position_rmse_m`` (the
        absolute trajectory error), ``position_final_m`` after the alignment; ``derotated_rmse_m``,
        ``se2_rmse_m`` after those; ``rotation_rad``; ``relative_rmse_m``: error of motions of one second;
        ``nees_position_per_dim`` (of the unaligned estimate); ``anchors_error_m`` (after the alignment; null
        where not located), null without true places.

    Raises
    ------
    InputError
        If the truth has another number of epochs, fewer than two of them count, or the alignment is unknown.
    """
    truth, start = np.asarray(track_m, dtype=np.float64), np.asarray(start_m, dtype=np.float64)
    if align not in ALIGNMENTS:
        raise InputError(f"align: expected one of {', '.join(ALIGNMENTS)}, got {align!r}")
    if truth.shape != (len(result.epoch), 2):
        raise InputError(f"truth: expected shape ({len(result.epoch)}, 2), got {truth.shape}")
    known = np.isfinite(truth).all(axis=1)
    if known.sum() < _LEAST_EPOCHS:
        raise InputError(
            f"truth: expected {_LEAST_EPOCHS} epochs of the result or more, got {int(known.sum())}"
        )
    true = truth[known] - start
    track = result.agent_mean[known, :2]
    angle = float(best_rotation(track, true))
    turned = derotated(track, angle)
    turn, shift = _rigid(track, true)
    aligned = {"start": track, "rotation": turned, "se2": track @ turn.T + shift}
    error = distances(aligned[align], true)
    covariance = result.agent_covariance[known, :2, :2]
    uncertain = np.linalg.eigvalsh(covariance)[:, 0] > 0.0
    off = track[uncertain] - true[uncertain]
    return {
        "epochs": int(known.sum()),
        "align": align,
        "position_mae_m": float(error.mean()),
        "position_rmse_m": _root_mean(error),
        "position_final_m": float(error[-1]),
        "rotation_rad": angle,
        "derotated_rmse_m": _root_mean(distances(turned, true)),
        "se2_rmse_m": _root_mean(distances(aligned["se2"], true)),
        "relative_rmse_m": _relative(result.time_s[known], aligned[align], true),
        "nees_position_per_dim": float(nees(off, covariance[uncertain]).mean()) if uncertain.any() else None,
        "anchors_error_m": None
        if anchors_m is None
        else _anchors(result, anchors_m, start, align, angle, turn, shift),
    }


def _root_mean(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _rigid(track: Array, true: Array) -> tuple[Array, Array]:
    """Rotation (2, 2) and shift (2,) that bring a track onto the true one."""
    centre, goal = track.mean(axis=0), true.mean(axis=0)
    turn = rotation_matrix(-float(best_rotation(track - centre, true - goal)))
    return turn, goal - turn @ centre


def _relative(time_s: Array, track: Array, true: Array) -> float | None:
    """RMSE of motions of about a second; None if the run is shorter."""
    later = np.searchsorted(time_s, time_s + _RELATIVE_S)
    first = np.flatnonzero(later < len(time_s))
    if first.size == 0:
        return None
    moved = (track[later[first]] - track[first]) - (true[later[first]] - true[first])
    return _root_mean(np.linalg.norm(moved, axis=1))


def _anchors(
    result: SlamResult,
    anchors_m: ArrayLike,
    start: Array,
    align: str,
    angle: float,
    turn: Array,
    shift: Array,
) -> list[float | None]:
    """Errors of the anchors at the last epoch."""
    places = np.asarray(anchors_m, dtype=np.float64)
    if places.shape != (len(result.anchors), 2):
        raise InputError(f"anchors: expected shape ({len(result.anchors)}, 2), got {places.shape}")
    found = result.anchor_mean_m[-1]
    if align == "rotation":
        found = found @ rotation_matrix(-angle).T
    elif align == "se2":
        found = found @ turn.T + shift
    return [
        float(np.linalg.norm(mean - place)) if valid else None
        for mean, place, valid in zip(found, places - start, result.anchor_valid[-1], strict=True)
    ]
