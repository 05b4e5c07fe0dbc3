"""Keeping the number of hypotheses small: prune, merge, cap."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.pool import Pool
from estimator.slam.gaussian.state import Rows, log_sum_exp

__all__ = ["moments", "tidy", "tidy_pool"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_FEW = 16  # rows of a run, of which all pairs are compared at once
_BLOCK = 32  # rows of the others that are compared with all at once
_INFLATION = 0.02  # of the variance, by an unlikely row


def moments(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a Gaussian mixture with weights (R,) that sum to one."""
    centre = weight @ mean
    offset = mean - centre
    return centre, np.tensordot(weight, covariance, 1) + (weight * offset.T) @ offset


def tidy(rows: Rows, config: GaussianConfig) -> Rows:
    """Normalised rows, likeliest first: the unlikely dropped, the alike merged, the rest capped."""
    return tidy_pool(Pool(rows, np.array([len(rows)])), config).rows


def tidy_pool(pool: Pool, config: GaussianConfig) -> Pool:
    """:func:`tidy` of each run of a pool."""
    pool, most = _ordered(pool, config), config.max_hypotheses
    first, second = _pairs(pool, config)
    if first.size:
        pool = pool.take(np.arange(len(pool.rows)))
        _merge(pool.rows, first, second)
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


def _pairs(pool: Pool, config: GaussianConfig) -> tuple[Index, Index]:
    """Pairs of rows of one run, the likelier first, that differ by less than their own uncertainty."""
    if pool.count.max() == 1:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    std = _std(pool.rows.covariance)
    near = [_near(pool.rows, std, a, b, config) for a, b in _candidates(pool)]
    first, second = (np.concatenate(each) for each in zip(*near, strict=True))
    return first, second


def _candidates(pool: Pool) -> Iterator[tuple[Index, Index]]:
    """All pairs of rows of one run, those of runs with many rows in pieces."""
    few = pool.count <= _FEW
    rank = np.where(few[pool.run], pool.rank, 0)
    b = np.repeat(np.arange(len(rank)), rank)
    before = b - 1 - np.arange(b.size) + np.repeat(np.cumsum(rank) - rank, rank)  # each row of its run
    yield before, b
    for i in np.flatnonzero(~few).tolist():
        for begin in range(0, int(pool.count[i]), _BLOCK):
            rows = np.arange(begin, min(begin + _BLOCK, pool.count[i]))
            first, second = np.nonzero(np.arange(pool.count[i]) > rows[:, None])
            yield pool.begin[i] + rows[first], pool.begin[i] + second


def _near(rows: Rows, std: Array, first: Index, second: Index, config: GaussianConfig) -> tuple[Index, Index]:
    """Those of the pairs with the same walls and anchors whose means are close."""
    kind = np.concatenate([rows.present, rows.located], axis=1)
    same = (kind[first] == kind[second]).all(axis=1)
    first, second = first[same], second[same]
    for part in (slice(0, 2), slice(2, None)):  # most are told apart by where the agent is
        limit = _alike(rows.log_weight[second] - rows.log_weight[first], config)[:, None]
        gap = np.abs(rows.mean[second, part] - rows.mean[first, part])
        close = (gap < limit * np.minimum(std[first, part], std[second, part])).all(axis=1)
        first, second = first[close], second[close]
    return first, second


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


def _merge(rows: Rows, first: Index, second: Index) -> None:
    """Rows become one with those that they are paired with, in place; these have no weight left.

    From the likeliest row of each run on, each takes what no other has taken.
    """
    free = np.ones(len(rows), dtype=bool)
    order = np.argsort(first, kind="stable")
    heads, begin = np.unique(first[order], return_index=True)
    for i, group in zip(heads.tolist(), np.split(second[order], begin[1:]), strict=True):
        group = group[free[group]]
        if not free[i] or group.size == 0:
            continue
        free[group] = False
        members = np.concatenate([[i], group])
        total = log_sum_exp(rows.log_weight[members])
        weight = np.exp(rows.log_weight[members] - total)
        rows.log_weight[group], rows.log_weight[i] = -np.inf, total
        rows.mean[i], rows.covariance[i] = moments(weight, rows.mean[members], rows.covariance[members])
        rows.visibility[i] = np.tensordot(weight, rows.visibility[members], 1)
