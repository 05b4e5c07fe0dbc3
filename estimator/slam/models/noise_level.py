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
from estimator.slam.models.kalman import projected, scalar_update
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
    levels_weighed : int
        Levels between them that are weighed: two that follow each other differ by a quarter.
    level_prior : float
        Measurements that the claim weighs.
    level_sigma : float
        An innovation counts as no more than so many standard deviations: it may be another path.
    level_visibility : float
        Features that are visible at least this surely tell the level.
    doubt_level : float
        Nothing is born while the mean square of an anchor's latest innovations is above this, over what is
        believed of them: what fits nothing may be what is known.
    doubt_memory : float
        Measurements that this mean is of.
    """

    alike_s: float = not_negative(0.0)
    level_memory: float = not_negative(100.0)
    least_level: float = positive(0.1)
    most_level: float = positive(25.0)
    levels_weighed: int = positive(25)
    level_prior: float = positive(3.0)
    level_sigma: float = positive(4.0)
    level_visibility: float = probability(0.8)
    doubt_level: float = positive(2.25)
    doubt_memory: float = positive(30.0)

    @property
    def model(self) -> LevelModel:
        """The same as compiled functions take it."""
        return LevelModel(
            self.alike_s,
            self.level_memory,
            self.least_level,
            self.most_level,
            self.levels_weighed,
            self.level_prior,
            self.level_sigma,
            self.level_visibility,
            self.doubt_memory,
        )


class LevelModel(NamedTuple):
    """What compiled functions take of :class:`NoiseLevel`."""

    alike_s: float
    memory: float
    least: float
    most: float
    grid: int
    prior: float
    sigma: float
    visibility: float
    doubt_memory: float


class Levels(NamedTuple):
    """What is believed of each anchor's noise.

    Parameters
    ----------
    heard_s : ndarray, shape (K,)
        When it was last heard, seconds; minus infinity before.
    level : ndarray, shape (K,)
        Factor on its claimed variance.
    log_odds : ndarray, shape (K, G)
        Log likelihoods of levels on a grid (:func:`level_grid`), forgotten with time.
    misfit : ndarray, shape (K,)
        Mean square of its latest innovations, over what was believed of them.
    """

    heard_s: Array
    level: Array
    log_odds: Array
    misfit: Array


def first_levels(anchors: int, levels_weighed: int) -> Levels:
    """What is believed before the first epoch: the claim."""
    log_odds = np.zeros((anchors, levels_weighed))
    return Levels(np.full(anchors, -np.inf), np.ones(anchors), log_odds, np.ones(anchors))


@compiled
def level_grid(model: LevelModel) -> Array:
    """Logarithms of the levels that are weighed, from the least to the most in equal steps."""
    return np.linspace(np.log(model.least), np.log(model.most), model.grid)


@compiled
def _alike(levels: Levels, k: int, time_s: float, model: LevelModel) -> float:
    """How many of an anchor's measurements tell what one would, at their present rate; at least one."""
    since = time_s - levels.heard_s[k]
    if not 0.0 < since < 2.0 * model.alike_s:
        return 1.0
    return float(2.0 * model.alike_s / since)


@compiled
def believed(
    paths: EpochPaths, range_std_m: float, levels: Levels, time_s: float, model: LevelModel
) -> EpochPaths:
    """The paths of an epoch with the deviations that are believed: those claimed, scaled.

    Of those claimed none is below ``range_std_m``.
    """
    std = paths.std_m.copy()
    for k in range(paths.number.size):
        factor = np.sqrt(levels.level[k] * _alike(levels, k, time_s, model))
        for j in range(paths.number[k]):
            std[k, j] = factor * max(std[k, j], range_std_m)
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
    chance: Array,
    paths: EpochPaths,
    clutter: Array,
    levels: Levels,
    time_s: float,
    model: LevelModel,
) -> Levels:
    """The levels after an epoch: lines of sight and single bounces that are surely visible tell them.

    The innovation of each feature's nearest path, given those before it, is Gaussian with the variance of
    the prediction and the level's times that of the claim, or the path is another: so each level of a grid
    has a likelihood. Time is that of as many Kalman updates as there are such features.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The likeliest hypothesis, predicted.
    active : ndarray of bool, shape (K, F)
        Features that it has.
    chance : ndarray, shape (K, F)
        Probability that each is visible.
    paths : EpochPaths
        The epoch's paths with the deviations that are believed.
    clutter : ndarray, shape (K,)
        Intensity per metre of paths that no feature gives.
    levels : Levels
        The levels so far.
    time_s : float
        The epoch's time, seconds.
    model : LevelModel
        How to learn.
    """
    after = Levels(levels.heard_s.copy(), levels.level.copy(), levels.log_odds.copy(), levels.misfit.copy())
    mean, covariance = mean.copy(), covariance.copy()
    source = sources(layout, mean, active)
    slanted = path_lengths(layout, mean, source)
    possible = possible_paths(layout, mean, source, active)
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    cross, before, grid = np.empty(mean.size), mean.copy(), level_grid(model)
    for k in range(layout.anchors):
        if paths.number[k] == 0:
            continue
        # of errors that are alike, innovations show but a part
        least = 0.0 if _alike(levels, k, time_s, model) >= 2.0 else grid[0]
        after.heard_s[k] = time_s
        if model.memory == 0.0:
            continue
        for f in range(1 + layout.slots):
            if not (possible[k, f] and chance[k, f] >= model.visibility):
                continue
            entries = length_gradient(layout, before, source, k, f, slanted[k, f], index, value)
            expected = slanted[k, f] + before[FIRST_ANCHOR + PER_ANCHOR * k + 3]
            for e in range(entries):
                expected += value[e] * (mean[index[e]] - before[index[e]])
            nearest, gap = 0, np.inf
            for j in range(paths.number[k]):
                if abs(paths.length_m[k, j] - expected) < abs(gap):
                    nearest, gap = j, paths.length_m[k, j] - expected
            spread = projected(covariance, index, value, entries, cross)
            noise = paths.std_m[k, nearest] ** 2
            if gap * gap > (2.0 * model.sigma) ** 2 * (spread + noise) and (paths.number[k] > 1 or f > 0):
                continue  # its path is not there
            square = min(gap * gap / (spread + noise), model.sigma**2)
            after.misfit[k] += (square - after.misfit[k]) / model.doubt_memory
            other = (1.0 - chance[k, f]) * clutter[k]
            for g in range(grid.size):
                total = spread + noise * np.exp(max(grid[g], least)) / levels.level[k]
                density = np.exp(-0.5 * gap * gap / total) / np.sqrt(2.0 * np.pi * total)
                after.log_odds[k, g] *= 1.0 - 1.0 / model.memory
                after.log_odds[k, g] += np.log(chance[k, f] * density + other)
            if square < model.sigma**2:
                scalar_update(mean, covariance, index, value, entries, gap, noise, cross)
        after.level[k] = _expected_level(after.log_odds[k], grid, least, model)
    return after


@compiled
def _expected_level(log_odds: Array, grid: Array, least: float, model: LevelModel) -> float:
    """The level whose logarithm is expected; beforehand it is normal about that of the claim."""
    total = weighted = 0.0
    top = -np.inf
    for g in range(grid.size):
        top = max(top, log_odds[g] - 0.25 * model.prior * grid[g] ** 2)
    for g in range(grid.size):
        weight = np.exp(log_odds[g] - 0.25 * model.prior * grid[g] ** 2 - top)
        total += weight
        weighted += weight * max(grid[g], least)
    return float(np.exp(weighted / total))
