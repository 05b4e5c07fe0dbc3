"""Mixture reduction: prune the unlikely hypotheses, merge those that are alike, cap the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.ordering import descending, taken
from estimator.slam.models.settings import Settings, positive
from estimator.slam.models.state_vector import Layout

__all__ = ["ReduceModel", "Reduction", "reduce_mixture", "reduction_model"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reduction(Settings):
    """Which hypotheses are kept.

    Parameters
    ----------
    prune_nats : float
        Hypotheses this far below the best are dropped.
    alike_sigma : float
        Hypotheses closer than this many standard deviations in every coordinate become one,
    unlikely_sigma : float
        or farther apart, up to this, if one of them is so unlikely that it hardly adds to the variance. Not
        in the first epochs, while the labels are open.
    inflation : float
        Share of the variance that an unlikely hypothesis may add.
    rounding_m : float
        Added to standard deviations: what is known exactly may differ by rounding, metres.
    max_hypotheses : int
        Hypotheses kept,
    max_memory_mib : float
        as long as they take less memory than this: with many anchors and walls there are fewer.
    """

    prune_nats: float = positive(12.0)
    alike_sigma: float = positive(0.7)
    unlikely_sigma: float = positive(2.0)
    inflation: float = positive(0.02)
    rounding_m: float = positive(1e-3)
    max_hypotheses: int = positive(100)
    max_memory_mib: float = positive(16.0)


class ReduceModel(NamedTuple):
    """What compiled reduction needs to know, in the present phase of a run; fields of :class:`Reduction`."""

    prune_nats: float
    alike_sigma: float
    unlikely_sigma: float
    inflation: float
    rounding_m: float
    most: int


def reduction_model(
    settings: Reduction, layout: Layout, prune_nats: float, unlikely_sigma: float, max_hypotheses: int
) -> ReduceModel:
    """What compiled reduction takes, in a phase of a run with its own limits; at least two hypotheses."""
    each = 8.0 * (layout.size * (layout.size + 1) + layout.anchors * layout.features)
    most = int(min(max_hypotheses, max(settings.max_memory_mib * 2**20 / each, 2)))
    return ReduceModel(
        prune_nats, settings.alike_sigma, unlikely_sigma, settings.inflation, settings.rounding_m, most
    )


@compiled
def _alike(hypotheses: Hypotheses, std: Array, i: int, j: int, limit: float) -> bool:
    """Whether hypotheses have the same walls and anchors, and means within ``limit`` deviations."""
    first, second = hypotheses.mean[i], hypotheses.mean[j]
    for a in range(first.size):
        if not abs(second[a] - first[a]) < limit * min(std[i, a], std[j, a]):
            return False
    for a in range(hypotheses.located.shape[1]):
        if hypotheses.located[i, a] != hypotheses.located[j, a]:
            return False
    for a in range(hypotheses.present.shape[1]):
        if hypotheses.present[i, a] != hypotheses.present[j, a]:
            return False
    return True


@compiled
def _merge(hypotheses: Hypotheses, members: NDArray[np.int64]) -> None:
    """Make the first of the members their moments, in place; the others are left without weight."""
    head = members[0]
    weight = np.empty(members.size)
    total = 0.0
    for i in range(members.size):
        weight[i] = np.exp(hypotheses.log_weight[members[i]] - hypotheses.log_weight[head])
        total += weight[i]
    for i in range(members.size):
        weight[i] /= total
    n = hypotheses.mean.shape[1]
    centre = np.zeros(n)
    spread = np.zeros((n, n))
    visibility = np.zeros(hypotheses.visibility[head].shape)
    for i in range(members.size):
        own_mean, own_visibility = hypotheses.mean[members[i]], hypotheses.visibility[members[i]]
        for a in range(n):
            centre[a] += weight[i] * own_mean[a]
        for k in range(visibility.shape[0]):
            for f in range(visibility.shape[1]):
                visibility[k, f] += weight[i] * own_visibility[k, f]
    for i in range(members.size):
        own_mean, own = hypotheses.mean[members[i]], hypotheses.covariance[members[i]]
        for a in range(n):
            offset = own_mean[a] - centre[a]
            for b in range(n):
                spread[a, b] += weight[i] * (own[a, b] + offset * (own_mean[b] - centre[b]))
    hypotheses.mean[head], hypotheses.covariance[head] = centre, spread
    hypotheses.visibility[head] = visibility
    hypotheses.log_weight[head] += np.log(total)
    for i in range(1, members.size):
        hypotheses.log_weight[members[i]] = -np.inf


@compiled
def _ordered(log_weight: Array, prune_nats: float) -> NDArray[np.int64]:
    """The hypotheses that are likely enough, likeliest first."""
    order = descending(log_weight)
    least = log_weight[order[0]] - prune_nats
    count = 1
    while count < order.size and log_weight[order[count]] > least:
        count += 1
    return order[:count]


@compiled
def _taken(hypotheses: Hypotheses, index: NDArray[np.int64]) -> Hypotheses:
    return Hypotheses(
        taken(hypotheses.log_weight, index),
        taken(hypotheses.mean, index),
        taken(hypotheses.covariance, index),
        taken(hypotheses.located, index),
        taken(hypotheses.present, index),
        taken(hypotheses.visibility, index),
        taken(hypotheses.support, index),
    )


@compiled
def reduce_mixture(hypotheses: Hypotheses, model: ReduceModel) -> Hypotheses:
    """Normalised hypotheses, likeliest first: the unlikely dropped, the alike merged, the rest capped.

    From the likeliest on, each takes those like itself that no other has taken. What merging adds to the
    variance is the offset squared times the smaller share of the weight: an unlikely hypothesis may stand
    farther off. Time is at most quadratic in the hypotheses and linear in their coordinates.

    Parameters
    ----------
    hypotheses : Hypotheses
        At least one; not changed.
    model : ReduceModel
        Limits.
    """
    kept = _taken(hypotheses, _ordered(hypotheses.log_weight, model.prune_nats))
    count, n = kept.mean.shape
    std = np.empty((count, n))
    for i in range(count):
        for a in range(n):
            std[i, a] = np.sqrt(max(kept.covariance[i, a, a], 0.0)) + model.rounding_m
    free = np.ones(count, dtype=np.bool_)
    weight = kept.log_weight.copy()
    members = np.empty(count, dtype=np.int64)
    merged = False
    for i in range(count):
        if not free[i]:
            continue
        members[0], size = i, 1
        for j in range(i + 1, count):
            if not free[j]:
                continue
            share = 1.0 / (1.0 + np.exp(-min(weight[j] - weight[i], 0.0)))
            limit = min(max(np.sqrt(model.inflation / share), model.alike_sigma), model.unlikely_sigma)
            if _alike(kept, std, i, j, limit):
                members[size] = j
                size += 1
                free[j] = False
        if size > 1:
            _merge(kept, members[:size])
            merged = True
    if merged:
        kept = _taken(kept, _ordered(kept.log_weight, model.prune_nats))
    if kept.log_weight.size > model.most:
        kept = _taken(kept, np.arange(model.most))
    best, total = kept.log_weight[0], 0.0
    for i in range(kept.log_weight.size):
        total += np.exp(kept.log_weight[i] - best)
    for i in range(kept.log_weight.size):
        kept.log_weight[i] -= best + np.log(total)
    return kept
