"""The results of successive stretches of a run, joined to the result of the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.result import SlamResult

__all__ = ["join_results"]

_IDS = ("wall_id", "candidate_wall_id")
_BY_EPOCH = (
    "epoch",
    "time_s",
    "agent_mean",
    "agent_covariance",
    "rotation_std_rad",
    "anchor_valid",
    "anchor_mean_m",
    "anchor_covariance_m2",
    "hypotheses",
    "log_evidence",
    "anchor_existence",
    "integrity_state",
    "integrity_probability",
    "protection_level_m",
)
_BY_WALL = ("wall_valid", "wall_mean_m", "wall_covariance_m2", "wall_existence")
_BY_CANDIDATE = ("candidate_weight", "candidate_agent_m")


def join_results(results: Sequence[SlamResult]) -> SlamResult:
    """Join results of stretches that follow each other, none of them smoothed.

    Parameters
    ----------
    results : sequence of SlamResult
        At least one, in their order; method, engine, seed, anchors and settings are those of the first.

    Returns
    -------
    SlamResult
        What one run over all their epochs would have given: a wall's column has its identity, and is empty
        where a stretch does not know it.
    """
    if len(results) == 1:
        return results[0]
    walls, candidates = (_union([getattr(one, name) for one in results]) for name in _IDS)
    most = max(one.candidate_weight.shape[1] for one in results)
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) for one in results]) for name in _BY_EPOCH
    }
    columns = {name: column for name, column in columns.items() if column.dtype != object}  # not told at all
    for name in _BY_WALL:
        placed = [
            _placed(getattr(one, name), 1, np.searchsorted(walls, one.wall_id), len(walls)) for one in results
        ]
        columns[name] = np.concatenate(placed)
    for name in _BY_CANDIDATE:
        own = [getattr(one, name) for one in results]
        columns[name] = np.concatenate([_placed(part, 1, np.arange(part.shape[1]), most) for part in own])
    columns["candidate_wall_mean_m"] = np.concatenate(
        [
            _placed(
                _placed(one.candidate_wall_mean_m, 1, np.arange(one.candidate_weight.shape[1]), most),
                2,
                np.searchsorted(candidates, one.candidate_wall_id),
                len(candidates),
            )
            for one in results
        ]
    )
    return replace(results[0], wall_id=walls, candidate_wall_id=candidates, **columns)


def _union(ids: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.unique(np.concatenate(ids)).astype(np.int64)


def _placed(values: NDArray[Any], axis: int, columns: NDArray[np.int64], count: int) -> NDArray[Any]:
    """Values whose entries along an axis go to the given columns of ``count``; the others are empty."""
    shape = list(values.shape)
    shape[axis] = count
    whole = np.zeros(shape, dtype=bool) if values.dtype == np.bool_ else np.full(shape, np.nan)
    whole[(slice(None),) * axis + (columns,)] = values
    return whole
