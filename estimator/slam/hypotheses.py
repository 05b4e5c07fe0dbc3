"""Keeping the number of hypotheses small: prune, merge, cap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from estimator.slam.config import GaussianConfig
from estimator.slam.state import GaussianState, take_rows

__all__ = ["reduce_rows", "tidy"]

Array = NDArray[np.float64]


def reduce_rows(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a Gaussian mixture with weights (R,) that sum to one."""
    centre = weight @ mean
    offset = mean - centre
    return centre, np.einsum("r,rij->ij", weight, covariance) + np.einsum("r,ri,rj->ij", weight, offset, offset)


def tidy(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """Normalise, drop the unlikely, merge the alike, keep the best ``max_hypotheses``."""
    weight = state.log_weight - logsumexp(state.log_weight)
    order = np.argsort(-weight, kind="stable")
    order = order[weight[order] > weight[order[0]] - config.prune_nats]
    rows = take_rows(state, order)
    rows["log_weight"] = weight[order]
    merged = _merge(rows)
    kept = np.argsort(-merged["log_weight"], kind="stable")[: config.max_hypotheses]
    merged = {name: values[kept] for name, values in merged.items()}
    merged["log_weight"] = merged["log_weight"] - logsumexp(merged["log_weight"])
    return replace(state, **merged)


def _merge(rows: dict[str, Array]) -> dict[str, Array]:
    """Rows (descending weight) that differ by less than their own uncertainty become one."""
    free = np.ones(len(rows["mean"]), dtype=bool)
    kept: list[int] = []
    result = {name: values.copy() for name, values in rows.items()}
    for i in range(len(free)):
        if not free[i]:
            continue
        free[i] = False
        kept.append(i)
        if not free.any():
            continue
        std = np.sqrt(np.maximum(np.diagonal(rows["covariance"][i]), 0.0)) + 1e-3
        other = np.sqrt(np.maximum(np.diagonal(rows["covariance"], axis1=1, axis2=2), 0.0)) + 1e-3
        close = np.all(np.abs(rows["mean"] - rows["mean"][i]) < 0.7 * np.minimum(std, other), axis=1)
        same = np.all(rows["present"] == rows["present"][i], axis=1)
        same &= np.all(rows["located"] == rows["located"][i], axis=1)
        group = np.flatnonzero(free & close & same)
        if group.size == 0:
            continue
        free[group] = False
        members = np.concatenate([[i], group])
        log_total = logsumexp(rows["log_weight"][members])
        weight = np.exp(rows["log_weight"][members] - log_total)
        result["log_weight"][i] = log_total
        result["mean"][i], result["covariance"][i] = reduce_rows(
            weight, rows["mean"][members], rows["covariance"][members]
        )
        result["visibility"][i] = np.einsum("r,rkf->kf", weight, rows["visibility"][members])
    index = np.array(kept, dtype=np.int64)
    return {name: values[index] for name, values in result.items()}
