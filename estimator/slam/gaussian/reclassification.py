"""Which paths of an epoch, and of recent epochs, the map explains.

Beside a known path stand its echoes, not new walls: a path counts as associated if a feature probably gave
it, or if it lies close to where any possible feature would be heard. A path was judged by the map of its
day; once an anchor is located, or turns out to be elsewhere, old paths find their explanation, and must not
start a wall. And the paths that *are* explained tell where nothing stands in the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import (
    MOST_ENTRIES,
    active_features,
    possible_paths,
    side_of_wall,
    sources,
)
from estimator.slam.models.kalman import projected
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.path_lengths import length_gradient, path_lengths
from estimator.slam.models.settings import Settings, positive, probability
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["Reclassification", "associated_now", "associated_then"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Reclassification(Settings):
    """What counts as explained.

    Parameters
    ----------
    explained_probability : float
        A path that comes from a feature with more than this probability is explained.
    pair_radius_m : float
        So is one this close to a predicted path, metres;
    beside_sigma : float
        and one within so many standard deviations of the prediction more,
    farthest_m : float
        but not farther than this, however badly the feature is known, metres.
    leg_sigma : float
        A path within so many standard deviations of a line of sight or single bounce shows that
        nothing stands in its way.
    """

    explained_probability: float = probability(0.3)
    pair_radius_m: float = positive(0.6)
    beside_sigma: float = positive(2.0)
    farthest_m: float = positive(3.0)
    leg_sigma: float = positive(3.0)


@compiled
def associated_now(
    layout: Layout,
    mean: Array,
    covariance: Array,
    located: Mask,
    present: Mask,
    confirmed: Mask,
    owner: Index,
    paths: EpochPaths,
    explained: Array,
    least: float,
    beside_m: float,
    beside_sigma: float,
    farthest_m: float,
) -> Mask:
    """Which paths (K, M) of an epoch a hypothesis explains.

    Parameters
    ----------
    layout, mean, covariance, located, present
        The hypothesis.
    confirmed, owner
        As in :func:`estimator.slam.models.features.active_features`.
    paths : EpochPaths
        The paths.
    explained : ndarray, shape (K, M)
        Probability that each comes from a feature.
    least, beside_m, beside_sigma, farthest_m : float
        As in :class:`Reclassification`.
    """
    anchors, measured = paths.length_m.shape
    associated = np.zeros((anchors, measured), dtype=np.bool_)
    active = active_features(layout, located, present, confirmed, owner)
    source = sources(layout, mean, active)
    slanted = path_lengths(layout, mean, source)
    possible = possible_paths(layout, mean, source, active)
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    cross = np.empty(mean.size)
    spread = np.full(active.shape, -1.0)
    for k in range(anchors):
        bias = mean[FIRST_ANCHOR + PER_ANCHOR * k + 3]
        for j in range(paths.number[k]):
            associated[k, j] = located[k] and explained[k, j] > least
            for f in range(active.shape[1]):
                if associated[k, j]:
                    break
                gap = abs(paths.length_m[k, j] - slanted[k, f] - bias)
                if not possible[k, f] or gap >= farthest_m:
                    continue
                if gap >= beside_m:
                    if spread[k, f] < 0.0:
                        used = length_gradient(layout, mean, source, k, f, slanted[k, f], index, value)
                        spread[k, f] = np.sqrt(max(projected(covariance, index, value, used, cross), 0.0))
                    if gap >= beside_m + beside_sigma * spread[k, f]:
                        continue
                associated[k, j] = True
    return associated


@compiled
def associated_then(
    layout: Layout,
    mean: Array,
    located: Mask,
    present: Mask,
    confirmed: Mask,
    owner: Index,
    buffer: PathBuffer,
    range_std_m: float,
    radius_m: float,
    radius_sigma: float,
    leg_sigma: float,
) -> tuple[Mask, Array]:
    """Which paths (N,) of the buffer a hypothesis explains today, and the legs (S, 2, 2) of those.

    Legs are straight pieces of the lines of sight and single bounces detected: end points, gauge frame,
    metres; nothing stands in their way. Time is that of the paths times the features.

    Parameters
    ----------
    layout, mean, located, present
        The hypothesis; the agent's position is replaced by that of each epoch.
    confirmed, owner
        As in :func:`estimator.slam.models.features.active_features`.
    buffer : PathBuffer
        Recent paths and where the agent was.
    range_std_m : float
        Smallest standard deviation of a path length, metres.
    radius_m, radius_sigma, leg_sigma : float
        ``pair_radius_m``, ``beside_sigma`` and ``leg_sigma`` of :class:`Reclassification`.
    """
    count = buffer.epoch.size
    near = np.zeros(count, dtype=np.bool_)
    legs, found = np.empty((2 * count, 2, 2)), 0
    active = active_features(layout, located, present, confirmed, owner)
    state = mean.copy()
    first_slot = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    n = 0
    for t in range(buffer.track.epoch.size):
        state[0], state[1] = buffer.track.position_m[t, 0], buffer.track.position_m[t, 1]
        source = sources(layout, state, active)
        slanted = path_lengths(layout, state, source)
        possible = possible_paths(layout, state, source, active)
        radius = radius_m + radius_sigma * buffer.track.std_m[t]
        while n < count and buffer.epoch[n] <= buffer.track.epoch[t]:
            if buffer.epoch[n] < buffer.track.epoch[t]:
                n += 1
                continue
            k = buffer.anchor[n]
            bias = mean[FIRST_ANCHOR + PER_ANCHOR * k + 3]
            width = leg_sigma * max(buffer.std_m[n], range_std_m)
            leg = False
            for f in range(active.shape[1]):
                gap = abs(buffer.length_m[n] - slanted[k, f] - bias)
                if not possible[k, f] or gap >= max(radius, width):
                    continue
                near[n] = near[n] or gap < radius
                if leg or f > layout.slots or not gap < width:
                    continue
                leg = True
                bx, by = source[k, 0, 0], source[k, 0, 1]
                if f > 0 and layout.shared:
                    w = first_slot + 2 * (f - 1)
                    here = side_of_wall(state[0], state[1], mean[w], mean[w + 1])
                    there = side_of_wall(source[k, f, 0], source[k, f, 1], mean[w], mean[w + 1])
                    fraction = here / (here - there)
                    bx = state[0] + fraction * (source[k, f, 0] - state[0])
                    by = state[1] + fraction * (source[k, f, 1] - state[1])
                    legs[found, 0, 0], legs[found, 0, 1] = bx, by
                    legs[found, 1, 0], legs[found, 1, 1] = source[k, 0, 0], source[k, 0, 1]
                    found += 1
                legs[found, 0, 0], legs[found, 0, 1] = state[0], state[1]
                legs[found, 1, 0], legs[found, 1, 1] = bx, by
                found += 1
            n += 1
    return near, legs[:found]
