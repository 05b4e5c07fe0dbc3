"""Keeping the number of hypotheses small: prune, merge, cap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.pool import Pool
from estimator.slam.gaussian.state import Rows, log_sum_exp

__all__ = ["moments", "tidy", "tidy_pool"]

Array = NDArray[np.float64]
_FEW = 16  # rows of a run, of which all pairs are compared at once
_BLOCK = 32  # rows that are compared with all others at once
_INFLATION = 0.02  # of the variance, by an unlikely row


def moments(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a Gaussian mixture with weights (R,) that sum to one."""
    centre = weight @ mean
    offset = mean - centre
    spread = np.einsum("r,ri,rj->ij", weight, offset, offset)
    return centre, np.einsum("r,rij->ij", weight, covariance) + spread


def tidy(rows: Rows, config: GaussianConfig) -> Rows:
    """Normalised rows, likeliest first: the unlikely dropped, the alike merged, the rest capped."""
    return tidy_pool(Pool(rows, np.array([len(rows)])), config).rows


def tidy_pool(pool: Pool, config: GaussianConfig) -> Pool:
    """:func:`tidy` of each run of a pool."""
    pool, most = _ordered(pool, config), config.max_hypotheses
    needy = _with_alike(pool, config)
    if needy.size:
        pool = pool.take(np.arange(len(pool.rows)))
        parts = pool.apart()
        for i in needy.tolist():
            _merge(parts[i], config)
        pool = _ordered(pool, config)
    if pool.count.max() > most:
        pool = pool.take(np.flatnonzero(pool.rank < most))
    weight = pool.rows.log_weight
    return Pool(pool.rows.but(log_weight=weight - pool.log_sum_exp(weight)[pool.run]), pool.count)


def _ordered(pool: Pool, config: GaussianConfig) -> Pool:
    """The rows of each run, likeliest first, the unlikely dropped."""
    if pool.count.max() == 1:
        return pool
    weight, run = pool.rows.log_weight, pool.run
    order = np.lexsort((-weight, run))
    least = np.maximum.reduceat(weight, pool.begin) - config.prune_nats
    order = order[weight[order] > least[run]]
    return pool.take(order) if len(order) < len(run) or np.any(order[1:] < order[:-1]) else pool


def _with_alike(pool: Pool, config: GaussianConfig) -> NDArray[np.int64]:
    """Runs with two rows that :func:`_merge` might make one; those of many rows are not asked."""
    if pool.count.max() == 1:
        return np.empty(0, dtype=np.int64)
    rank, run = pool.rank, pool.run
    rank = np.where((pool.count <= _FEW)[run], rank, 0)
    b = np.repeat(np.arange(len(rank)), rank)
    a = b - 1 - np.arange(b.size) + np.repeat(np.cumsum(rank) - rank, rank)  # every row before b in its run
    mean, covariance = pool.rows.mean, pool.rows.covariance
    std = _std(covariance)
    limit = _alike(pool.rows.log_weight[b] - pool.rows.log_weight[a], config)
    near = np.abs(mean[a] - mean[b]) < limit[:, None] * np.minimum(std[a], std[b])
    return np.unique(np.concatenate([run[a[near.all(axis=1)]], np.flatnonzero(pool.count > _FEW)]))


def _alike(log_ratio: Array, config: GaussianConfig) -> Array:
    """How many standard deviations apart rows are the same, given the log ratio of their weights.

    What merging adds to the variance is the offset squared times the smaller share of the weight: an
    unlikely row may stand farther off.
    """
    share = 1.0 / (1.0 + np.exp(-np.minimum(log_ratio, 0.0)))
    return np.clip(np.sqrt(_INFLATION / share), config.alike_sigma, config.unlikely_sigma)


def _std(covariance: Array) -> Array:
    """Standard deviations (R, n), a millimetre and more: what is known exactly may differ by rounding."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)) + 1e-3)


def _merge(rows: Rows, config: GaussianConfig) -> None:
    """Rows (descending weight) that differ by less than their own uncertainty become one, in place.

    Those that are now in another have no weight left.
    """
    std, kind = _std(rows.covariance), _kinds(rows)
    free = np.ones(len(rows), dtype=bool)
    for begin in range(0, len(rows), _BLOCK):
        own = np.arange(begin, min(begin + _BLOCK, len(rows)))
        first, second = np.nonzero((kind[own, None] == kind) & (np.arange(len(rows)) > own[:, None]) & free)
        first += begin
        limit = _alike(rows.log_weight[second] - rows.log_weight[first], config)[:, None]
        for part in (slice(0, 2), slice(2, None)):  # most are told apart by where the agent is
            gap = np.abs(rows.mean[second, part] - rows.mean[first, part])
            near = (gap < limit * np.minimum(std[first, part], std[second, part])).all(axis=1)
            first, second, limit = first[near], second[near], limit[near]
        for i in np.unique(first).tolist():
            group = second[first == i]
            group = group[free[group]]
            if free[i] and group.size:
                free[group] = False
                _absorb(rows, i, group)


def _absorb(rows: Rows, i: int, group: NDArray[np.int64]) -> None:
    """Merge the rows ``group`` into row ``i``."""
    members = np.concatenate([[i], group])
    total = log_sum_exp(rows.log_weight[members])
    weight = np.exp(rows.log_weight[members] - total)
    rows.log_weight[group], rows.log_weight[i] = -np.inf, total
    rows.mean[i], rows.covariance[i] = moments(weight, rows.mean[members], rows.covariance[members])
    rows.visibility[i] = np.einsum("r,rkf->kf", weight, rows.visibility[members])


def _kinds(rows: Rows) -> NDArray[np.int64]:
    """A number for each row, the same for rows with the same walls and anchors."""
    seen: dict[bytes, int] = {}
    has = np.concatenate([rows.present, rows.located], axis=1)
    return np.array([seen.setdefault(row.tobytes(), len(seen)) for row in has])
