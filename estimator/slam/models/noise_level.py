"""Noise levels: how far the standard deviations that measurements claim are believed, anchor by anchor.

Two things are wrong with the deviations of ranges as devices claim them. Errors of epochs that follow each
other closely are alike (multipath and interference last), so that a hundred ranges a second do not tell
what a hundred independent ones would. And the claim itself may be off: innovations show it, and each
anchor's variance is scaled by what they have shown lately, within bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import MOST_ENTRIES, possible_paths, sources
from estimator.slam.models.kalman import projected
from estimator.slam.models.path_lengths import length_gradient, path_lengths
from estimator.slam.models.settings import Settings, not_negative, positive, probability
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["LevelModel", "Levels", "NoiseLevel", "believed", "first_levels", "learned"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class NoiseLevel(Settings):
    """How far claimed deviations are believed.

    Parameters
    ----------
    alike_s : float
        Errors of an anchor's path lengths are alike for this long, seconds: in twice that time they tell
        what one does. 0 says that they are independent.
    level_memory : float
        Measurements of an anchor over which the level of its variance is learnt; 0 believes the claim.
    least_level, most_level : float
        Bounds of the level, a factor on the claimed variance.
    level_prior : float
        Measurements that the claim weighs at the start.
    level_sigma : float
        An innovation counts as no more than so many standard deviations: it may be another path.
    level_visibility : float
        Features that are visible at least this surely tell the level.
    doubt_level : float
        Nothing is born while an anchor's level is above this: what fits nothing may be what is known.
    """

    alike_s: float = not_negative(0.0)
    level_memory: float = not_negative(0.0)
    least_level: float = positive(0.1)
    most_level: float = positive(25.0)
    level_prior: float = positive(3.0)
    level_sigma: float = positive(4.0)
    level_visibility: float = probability(0.8)
    doubt_level: float = positive(2.25)

    @property
    def model(self) -> LevelModel:
        """The same as compiled functions take it."""
        return LevelModel(
            self.alike_s,
            self.level_memory,
            self.least_level,
            self.most_level,
            self.level_prior,
            self.level_sigma,
            self.level_visibility,
        )


class LevelModel(NamedTuple):
    """What compiled functions take of :class:`NoiseLevel`."""

    alike_s: float
    memory: float
    least: float
    most: float
    prior: float
    sigma: float
    visibility: float


class Levels(NamedTuple):
    """What is believed of each anchor's noise.

    Parameters
    ----------
    heard_s : ndarray, shape (K,)
        When it was last heard, seconds; minus infinity before.
    level : ndarray, shape (K,)
        Factor on its claimed variance.
    told_by : ndarray, shape (K,)
        Measurements that tell it.
    """

    heard_s: Array
    level: Array
    told_by: Array


def first_levels(anchors: int) -> Levels:
    """What is believed before the first epoch: the claim."""
    return Levels(np.full(anchors, -np.inf), np.ones(anchors), np.zeros(anchors))


@compiled
def _alike(levels: Levels, k: int, time_s: float, model: LevelModel) -> float:
    """How many of an anchor's measurements tell what one would, at their present rate; at least one."""
    since = time_s - levels.heard_s[k]
    if not 0.0 < since < 2.0 * model.alike_s:
        return 1.0
    return float(2.0 * model.alike_s / since)


@compiled
def believed(paths: EpochPaths, levels: Levels, time_s: float, model: LevelModel) -> EpochPaths:
    """The paths of an epoch with the deviations that are believed."""
    std = paths.std_m.copy()
    for k in range(paths.number.size):
        factor = np.sqrt(levels.level[k] * _alike(levels, k, time_s, model))
        for j in range(paths.number[k]):
            std[k, j] *= factor
    return EpochPaths(
        paths.number,
        paths.length_m,
        std,
        paths.excess_loss_db,
        paths.azimuth_rad,
        paths.azimuth_std_rad,
        paths.heading_held,
        paths.asked,
    )


@compiled
def learned(
    layout: Layout,
    mean: Array,
    covariance: Array,
    active: Mask,
    visibility: Array,
    paths: EpochPaths,
    range_std_m: float,
    levels: Levels,
    time_s: float,
    model: LevelModel,
) -> Levels:
    """The levels after an epoch: lines of sight and single bounces that are surely visible tell them.

    Time is that of these features, times the paths.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The likeliest hypothesis, predicted.
    active : ndarray of bool, shape (K, F)
        Features that it has.
    visibility : ndarray, shape (K, F)
        Probability that each is visible.
    paths : EpochPaths
        The epoch's paths with the deviations that are believed.
    range_std_m : float
        Smallest standard deviation believed of a path length, metres.
    levels : Levels
        The levels so far.
    time_s : float
        The epoch's time, seconds.
    model : LevelModel
        How to learn.
    """
    after = Levels(levels.heard_s.copy(), levels.level.copy(), levels.told_by.copy())
    source = sources(layout, mean, active)
    slanted = path_lengths(layout, mean, source)
    possible = possible_paths(layout, mean, source, active)
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    cross = np.empty(mean.size)
    for k in range(layout.anchors):
        if paths.number[k] == 0:
            continue
        # of errors that are alike, innovations show but a part
        least = model.least if _alike(levels, k, time_s, model) < 2.0 else 1.0
        after.heard_s[k] = time_s
        if model.memory == 0.0:
            continue
        for f in range(1 + layout.slots):
            if not (possible[k, f] and visibility[k, f] >= model.visibility):
                continue
            expected = slanted[k, f] + mean[FIRST_ANCHOR + PER_ANCHOR * k + 3]
            nearest, gap = 0, np.inf
            for j in range(paths.number[k]):
                if abs(paths.length_m[k, j] - expected) < abs(gap):
                    nearest, gap = j, paths.length_m[k, j] - expected
            entries = length_gradient(layout, mean, source, k, f, slanted[k, f], index, value)
            spread = projected(covariance, index, value, entries, cross)
            noise = max(paths.std_m[k, nearest], range_std_m) ** 2
            total = spread + noise
            if gap * gap > (2.0 * model.sigma) ** 2 * total and (paths.number[k] > 1 or f > 0):
                continue  # its path is not there
            square = min(gap * gap / total, model.sigma**2)
            # the mean square of the error, given the innovation, over what was believed
            shown = levels.level[k] * (noise / total * square + spread / total)
            after.told_by[k] = min(after.told_by[k] + 1.0, model.memory)
            level = after.level[k] + (shown - after.level[k]) / (model.prior + after.told_by[k])
            after.level[k] = min(max(level, least), model.most)
    return after
