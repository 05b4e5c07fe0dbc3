"""The agent found again by paths alone: where no sweep comes and what the paths say is not what is thought.

While a run is suspect, the paths of an epoch are held now and then against all places of the mapped area, on
a grid: each path, with its direction where it has one, may be the line of sight to a located anchor, a bounce
off a known wall, or neither. The best places become hypotheses, as those of
:mod:`estimator.slam.gaussian.relocation`, and the update weighs them against the others. Time is that of the
cells times paths times walls; all three are bounded.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.map_search import (
    FAR,
    Known,
    Places,
    Relocation,
    best_places,
    elsewhere,
    grid,
    map_of,
)
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.directions import wrapped
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, THETA, Layout
from estimator.slam.models.visibility import Visibility

__all__ = ["path_scores", "places_by_paths", "search_elsewhere"]

Array = NDArray[np.float64]


@compiled
def path_scores(
    layout: Layout,
    known: Known,
    cells: Array,
    cell_m: float,
    paths: EpochPaths,
    clutter: Array,
    prior_sight: float,
    prior_wall: float,
) -> Array:
    """Log likelihood (C,) of places of the agent, over that of a place where nothing is known.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    known : Known
        The map.
    cells : ndarray, shape (C, 2)
        Places, gauge frame, metres,
    cell_m : float
        and how far apart they are.
    paths : EpochPaths
        Paths of the epoch.
    clutter : ndarray, shape (K,)
        Density of paths that no known feature gives, per metre.
    prior_sight, prior_wall : float
        Probabilities that a line of sight, and a bounce off a wall, is heard.
    """
    mean, present, located = known
    first = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    blur = cell_m * cell_m / 6.0  # of a place within its cell, and what it does to a length
    score = np.zeros(cells.shape[0])
    source, prior = np.empty((layout.slots + 1, 2)), np.empty(layout.slots + 1)
    for k in range(layout.anchors):
        if not located[k] or paths.number[k] == 0:
            continue
        a = FIRST_ANCHOR + PER_ANCHOR * k
        source[0, 0], source[0, 1], prior[0] = mean[a], mean[a + 1], prior_sight
        sources = 1
        for i in range(layout.slots):
            if present[i]:
                x, y = mean[first + 2 * i], mean[first + 2 * i + 1]
                share = 1.0 - 2.0 * (mean[a] * x + mean[a + 1] * y) / max(x * x + y * y, 1e-12)
                source[sources, 0], source[sources, 1] = mean[a] + share * x, mean[a + 1] + share * y
                prior[sources] = prior_wall
                sources += 1
        for cell in range(cells.shape[0]):
            for m in range(paths.number[k]):
                variance = paths.std_m[k, m] ** 2 + blur
                scale = 1.0 / (np.sqrt(2.0 * np.pi * variance) * clutter[k])
                ratio = 1.0
                for f in range(sources):
                    dx, dy = source[f, 0] - cells[cell, 0], source[f, 1] - cells[cell, 1]
                    length = np.sqrt(max(dx * dx + dy * dy + mean[a + 2], 0.0))
                    gap = paths.length_m[k, m] - (1.0 + mean[a + 4]) * length - mean[a + 3]
                    square = gap * gap / variance
                    if square > FAR:
                        continue
                    own = prior[f] * scale * np.exp(-0.5 * square)
                    if paths.heading_held and np.isfinite(paths.azimuth_std_rad[k, m]):
                        spread = paths.azimuth_std_rad[k, m] ** 2 + blur / (dx * dx + dy * dy + blur)
                        off = wrapped(paths.azimuth_rad[k, m] - mean[THETA] - np.arctan2(dy, dx))
                        own *= np.sqrt(2.0 * np.pi / spread) * np.exp(-0.5 * off * off / spread)
                    ratio += own
                score[cell] += np.log(ratio)
    return score


def places_by_paths(
    state: GaussianState, paths: EpochPaths, clutter: Array, model: Relocation, visibility: Visibility
) -> tuple[Places, bool] | None:
    """Places of the map that explain an epoch's paths best.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses.
    paths : EpochPaths
        Paths of the epoch.
    clutter : ndarray, shape (K,)
        Density of paths that no known feature gives, per metre.
    model : Relocation
        Where.
    visibility : Visibility
        How probably a feature is heard.

    Returns
    -------
    places : Places
        The best places.
    here : bool
        Whether there is one alone, and that the one where the agent is thought to be. None of both without a
        wall or an anchor to go by.
    """
    layout, known = state.layout, map_of(state)
    if not known.present.any() or not known.located.any():
        return None
    cells, cell_m = grid(layout, known, model)
    sight, wall = visibility.prior_sight, visibility.prior_wall
    score = path_scores(layout, known, cells, cell_m, paths, clutter, sight, wall)
    best = cells[best_places(cells, score, model)]
    here = len(best) == 1 and bool(np.linalg.norm(best[0] - known.mean[:2]) < model.apart_m)
    return Places(best, cell_m, len(cells)), here and bool(score.max() > model.worse_nats)


def search_elsewhere(
    state: GaussianState, paths: EpochPaths, clutter: Array, config: GaussianConfig
) -> tuple[GaussianState, bool]:
    """Look for the agent elsewhere, now and then while the run is suspect.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses.
    paths : EpochPaths
        Paths of the epoch.
    clutter : ndarray, shape (K,)
        Density of paths that no known feature gives, per metre.
    config : GaussianConfig
        Models.

    Returns
    -------
    state : GaussianState
        With hypotheses of the agent elsewhere, if it was looked for.
    here : bool
        Whether it is where it is thought to be, and could be nowhere else.
    """
    model, suspected = config.relocation, int(state.indicators.suspected)
    doubled = suspected & (suspected - 1) == 0 and suspected < model.retry_epochs
    settled = state.indicators.settled >= config.integrity.settled_epochs
    if not settled or suspected == 0 or not (doubled or suspected % model.retry_epochs == 0):
        return state, False
    found = places_by_paths(state, paths, clutter, model, config.visibility)
    if found is None:
        return state, False
    places, here = found
    if here:
        return state, True
    std_m, speed_std_m_s = model.path_place_std_m, config.motion.speed_std_m_s
    more = elsewhere(state, places, std_m, model, config.visibility, speed_std_m_s)
    return state.but(hypotheses=state.hypotheses.joined(more)), False
