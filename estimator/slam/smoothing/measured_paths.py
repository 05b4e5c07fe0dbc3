"""Measured paths in Gauss-Newton's model: their share of its information, and what it says of lengths.

Each path depends on the agent's place and on a dozen numbers that stand still; only these are touched, so
that time goes with the number of paths, and memory with that of features and epochs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.directions import azimuth_gradient, azimuth_of, wrapped
from estimator.slam.models.features import MOST_ENTRIES, sources
from estimator.slam.models.path_lengths import length_gradient, path_lengths
from estimator.slam.models.state_vector import AGENT, FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["add_paths", "length_variances"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_AGENT: int = AGENT.stop


@compiled
def add_paths(
    layout: Layout,
    agent: Array,
    still: Array,
    column: Index,
    epoch: Index,
    anchor: Index,
    feature: Index,
    length_m: Array,
    std_m: Array,
    azimuth_rad: Array,
    azimuth_std_rad: Array,
    chain: Array,
    border: Array,
    corner: Array,
    right: Array,
    below: Array,
) -> float:
    """Add the information of paths, linearised at a trajectory, to that of the run; their cost.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    agent, still : ndarray, shapes (T, 4) and (n,)
        The trajectory.
    column : ndarray of int64, shape (n,)
        Column of the border of each element of the state vector; -1 where it is known, or the agent's.
    epoch, anchor, feature : ndarray of int64, shape (N,)
        Where the paths come from; epochs ascend.
    length_m, std_m : ndarray, shape (N,)
        Path lengths and standard deviations.
    azimuth_rad, azimuth_std_rad : ndarray, shape (N,)
        Directions in the gauge frame's axes; an infinite standard deviation where there is none.
    chain, border, corner, right, below : ndarray
        Matrix and right-hand side, added to.

    Returns
    -------
    float
        Sum of squared whitened residuals.
    """
    features = 1 + layout.slots + (layout.slots * layout.slots if layout.shared else 0)
    index, value = np.empty(MOST_ENTRIES + 1, dtype=np.int64), np.empty(MOST_ENTRIES + 1)
    cost, first = 0.0, 0
    while first < epoch.size:
        t, last = epoch[first], first
        active = np.zeros((layout.anchors, features), dtype=np.bool_)
        while last < epoch.size and epoch[last] == t:
            f = feature[last]
            active[anchor[last], f] = True
            if layout.shared and f > layout.slots:  # the image whose image it is
                active[anchor[last], 1 + (f - 1 - layout.slots) // layout.slots] = True
            last += 1
        mean = still.copy()
        mean[:_AGENT] = agent[t]
        source = sources(layout, mean, active)
        slanted = path_lengths(layout, mean, source)
        for i in range(first, last):
            k, f = anchor[i], feature[i]
            bias = mean[FIRST_ANCHOR + PER_ANCHOR * k + 3]
            residual = (length_m[i] - slanted[k, f] - bias) / std_m[i]
            count = length_gradient(layout, mean, source, k, f, slanted[k, f], index, value)
            cost += _add(
                column, index, value, count, 1.0 / std_m[i], residual, t, chain, border, corner, right, below
            )
            if np.isfinite(azimuth_std_rad[i]):
                residual = wrapped(azimuth_rad[i] - azimuth_of(mean, source, k, f)) / azimuth_std_rad[i]
                count = azimuth_gradient(layout, mean, source, k, f, index, value)
                weight = 1.0 / azimuth_std_rad[i]
                cost += _add(
                    column, index, value, count, weight, residual, t, chain, border, corner, right, below
                )
        first = last
    return cost


@compiled
def _add(
    column: Index,
    index: Index,
    value: Array,
    count: int,
    weight: float,
    residual: float,
    t: int,
    chain: Array,
    border: Array,
    corner: Array,
    right: Array,
    below: Array,
) -> float:
    """Add one measurement with derivatives ``weight value``; its cost."""
    for a in range(count):
        va, ia = weight * value[a], index[a]
        if ia < _AGENT:
            right[t, ia] += va * residual
        elif column[ia] >= 0:
            below[column[ia]] += va * residual
        else:
            continue
        for b in range(count):
            product, ib = va * weight * value[b], index[b]
            if ia < _AGENT and ib < _AGENT:
                chain[t, ia, ib] += product
            elif column[ib] >= 0:
                if ia < _AGENT:
                    border[t, ia, column[ib]] += product
                elif ib >= _AGENT:
                    corner[column[ia], column[ib]] += product
    return residual * residual


@compiled
def length_variances(
    layout: Layout, agent: Array, still: Array, column: Index, chain: Array, cross: Array, border: Array
) -> Array:
    """Variances (T, K, F) of the lengths of all features that a smoothed run predicts, square metres.

    Parameters
    ----------
    layout, agent, still, column
        As for :func:`add_paths`.
    chain, cross, border : ndarray, shapes (T, 4, 4), (T, 4, q) and (q, q)
        Covariances of the run.
    """
    features = 1 + layout.slots + (layout.slots * layout.slots if layout.shared else 0)
    every = np.ones((layout.anchors, features), dtype=np.bool_)
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    result = np.empty((agent.shape[0], layout.anchors, features))
    mean = still.copy()
    for t in range(agent.shape[0]):
        mean[:_AGENT] = agent[t]
        source = sources(layout, mean, every)
        slanted = path_lengths(layout, mean, source)
        for k in range(layout.anchors):
            for f in range(features):
                count = length_gradient(layout, mean, source, k, f, slanted[k, f], index, value)
                total = 0.0
                for a in range(count):
                    for b in range(count):
                        ia, ib, entry = index[a], index[b], 0.0
                        if ia < _AGENT and ib < _AGENT:
                            entry = chain[t, ia, ib]
                        elif ia < _AGENT and column[ib] >= 0:
                            entry = cross[t, ia, column[ib]]
                        elif ib < _AGENT and column[ia] >= 0:
                            entry = cross[t, ib, column[ia]]
                        elif ia >= _AGENT and ib >= _AGENT and column[ia] >= 0 and column[ib] >= 0:
                            entry = border[column[ia], column[ib]]
                        total += value[a] * value[b] * entry
                result[t, k, f] = max(total, 0.0)
    return result
