"""Keeping the number of hypotheses small: prune, merge, cap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.state import Rows, log_sum_exp

__all__ = ["moments", "tidy"]

Array = NDArray[np.float64]
_FEW = 16  # rows, of which all pairs are compared at once
_ALIKE_SIGMA = 0.7  # rows closer than this in every coordinate become one


def moments(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a Gaussian mixture with weights (R,) that sum to one."""
    centre = weight @ mean
    offset = mean - centre
    spread = np.einsum("r,ri,rj->ij", weight, offset, offset)
    return centre, np.einsum("r,rij->ij", weight, covariance) + spread


def tidy(rows: Rows, config: GaussianConfig) -> Rows:
    """Normalised rows, likeliest first: the unlikely dropped, the alike merged, the rest capped."""
    weight = rows.log_weight - log_sum_exp(rows.log_weight)
    order = np.argsort(-weight, kind="stable")
    order = order[weight[order] > weight[order[0]] - config.prune_nats]
    merged = _merge(rows.take(order))
    order = np.argsort(-merged.log_weight, kind="stable")[: config.max_hypotheses]
    return merged.take(order).keep(np.ones(order.size, dtype=bool))


def _any_alike(mean: Array, std: Array) -> bool:
    """Whether the means (R, n) of any two rows are closer than their standard deviations allow."""
    a, b = np.triu_indices(len(mean), 1)
    return bool(np.any(np.all(np.abs(mean[a] - mean[b]) < _ALIKE_SIGMA * np.minimum(std[a], std[b]), axis=1)))


def _merge(rows: Rows) -> Rows:
    """Rows (descending weight) that differ by less than their own uncertainty become one."""
    if len(rows) == 1:
        return rows
    std = np.sqrt(np.maximum(np.diagonal(rows.covariance, axis1=1, axis2=2), 0.0)) + 1e-3
    if len(rows) <= _FEW and not _any_alike(rows.mean, std):
        return rows
    free = np.ones(len(rows), dtype=bool)
    kind = _kinds(rows)
    kept: list[int] = []
    for i in range(len(rows)):
        if not free[i]:
            continue
        free[i] = False
        kept.append(i)
        group = np.flatnonzero(free & (kind == kind[i]))
        if group.size == 0:
            continue
        limit = _ALIKE_SIGMA * np.minimum(std[i], std[group])
        group = group[(np.abs(rows.mean[group] - rows.mean[i]) < limit).all(axis=1)]
        if group.size == 0:
            continue
        free[group] = False
        members = np.concatenate([[i], group])
        total = log_sum_exp(rows.log_weight[members])
        weight = np.exp(rows.log_weight[members] - total)
        rows.log_weight[i] = total
        rows.mean[i], rows.covariance[i] = moments(weight, rows.mean[members], rows.covariance[members])
        rows.visibility[i] = np.einsum("r,rkf->kf", weight, rows.visibility[members])
    return rows.take(kept)


def _kinds(rows: Rows) -> NDArray[np.int64]:
    """A number for each row, the same for rows with the same walls and anchors."""
    seen: dict[bytes, int] = {}
    has = np.concatenate([rows.present, rows.located], axis=1)
    return np.array([seen.setdefault(row.tobytes(), len(seen)) for row in has])
