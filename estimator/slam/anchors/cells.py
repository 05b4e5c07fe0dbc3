"""What a search tries, clock biases and heights, and what it may cost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.config import AnchorSearchConfig

__all__ = ["Cells", "SearchLimits", "cells_of", "heights_of", "known_cell", "limits_of"]

Array = NDArray[np.float64]


class Cells(NamedTuple):
    """The clock biases and squared heights that a search tries, G of them.

    Parameters
    ----------
    bias_m, height2_m2, height2_std_m2 : ndarray, shape (G,)
        Clock bias, metres; squared height difference and its standard deviation, square metres.
    log_prior : ndarray, shape (G,)
        Log prior probability.
    """

    bias_m: Array
    height2_m2: Array
    height2_std_m2: Array
    log_prior: Array


class SearchLimits(NamedTuple):
    """What a search may cost: see :class:`AnchorSearchConfig`.

    Parameters
    ----------
    pairs, pairs_in_all : int
        Pairs of circles that are intersected, of one cell and of all.
    paired_circles, paired_paths : int
        Circles and paths of which pairs are made at least.
    scored : int
        Intersections that are scored with double bounces.
    refined, refined_in_all : int
        Intersections that are chosen, of one cell and of all.
    """

    pairs: int
    pairs_in_all: int
    paired_circles: int
    paired_paths: int
    scored: int
    refined: int
    refined_in_all: int


def known_cell(bias_m: float) -> Cells:
    """The one cell of a known clock, in the plane."""
    return Cells(np.array([bias_m]), np.zeros(1), np.zeros(1), np.zeros(1))


def cells_of(mean_m: float, std_m: float, config: AnchorSearchConfig) -> tuple[Cells, float]:
    """The clock biases and heights to try, and the variance of lengths, square metres, that the biases leave.

    Parameters
    ----------
    mean_m, std_m : float
        What is known of the clock bias, metres.
    config : AnchorSearchConfig
        Spacing and number of biases and heights.
    """
    height2, height2_std, height_prior = heights_of(config)
    if std_m < config.clock_step_m:
        bias, log_prior, left = np.array([mean_m]), np.zeros(1), std_m**2
    else:
        step = max(config.clock_step_m, 2.0 * config.clock_sigma * std_m / (config.max_clocks - 1))
        shift = np.arange(-config.clock_sigma * std_m, config.clock_sigma * std_m + step, step)
        bias, left = mean_m + shift, step**2 / 12.0
        log_prior = -0.5 * (shift / std_m) ** 2 + np.log(step / (std_m * np.sqrt(2.0 * np.pi)))
    g, h = (index.ravel() for index in np.indices((bias.size, height2.size)))
    width = config.height_widths * height2_std[h] if config.height_cells else height2_std[h]
    return Cells(bias[g], height2[h], width, log_prior[g] + height_prior[h]), left


def heights_of(config: AnchorSearchConfig) -> tuple[Array, Array, Array]:
    """Squared heights (H,), their standard deviations, and their log priors."""
    if config.height_cells == 0:
        return np.zeros(1), np.zeros(1), np.zeros(1)
    height = np.geomspace(config.height_min_m, config.height_max_m, config.height_cells)
    edge = np.concatenate([[0.0], np.sqrt(height[1:] * height[:-1]), [config.height_max_m]])
    mass = np.exp(-edge[:-1] / config.height_scale_m) - np.exp(-edge[1:] / config.height_scale_m)
    return height**2, np.diff(edge**2) / np.sqrt(12.0), np.log(mass / mass.sum())


def limits_of(share: int, cells: int, circles: Circles, config: AnchorSearchConfig) -> SearchLimits:
    """What one of ``share`` searches of so many cells may cost."""
    walls, every = 1 + circles.walls, circles.x.shape[1]
    scored = config.max_scored_circles // (share * max(every - walls, 1))
    refined = min(config.max_refined_in_all, config.max_refined_circles // circles.x.size) // share
    return SearchLimits(
        pairs=config.max_pairs,
        pairs_in_all=config.max_pair_circles // (share * walls),
        paired_circles=config.min_paired_circles,
        paired_paths=config.min_paired_paths,
        scored=max(min(config.max_scored * cells, scored), 1),
        refined=config.max_refined,
        refined_in_all=max(refined, 1),
    )
