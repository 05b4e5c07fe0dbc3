"""The agent found again in the map it has: at every sweep it may be anywhere, with a small probability.

A sweep that no hypothesis explains is held against all places of the mapped area, on a grid, by its flashes
and the lines of sight to located anchors. The best places become hypotheses: the map of the likeliest one,
the agent there, its velocity unknown. What the sweep and the paths say of them is then weighed as for all
others. Time is that of the cells times flashes and walls, and times paths; the cells are bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.association.sweep_matching import flash_cost
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
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.state_vector import (
    ECHO_BIAS,
    FIRST_ANCHOR,
    HEADING,
    PER_ANCHOR,
    THETA,
    Layout,
)
from estimator.slam.models.sweeps import FLASH_ENTRIES
from estimator.slam.models.visibility import Visibility

__all__ = ["Seen", "is_explained", "place_scores", "relocated"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_LEAST_M: Final = 1e-3  # numerical floor of a distance


class Seen(NamedTuple):
    """What an epoch shows of where the agent is.

    Parameters
    ----------
    flash, noise : ndarray, shapes (J, 2) and (J, 2, 2)
        Mirror images of the agent relative to it, in the gauge frame's axes, and their covariances.
    new_density : float
        Density of flashes of unknown walls, per metre of range and radian.
    number, length_m, std_m : ndarray, shapes (K,), (K, M) and (K, M)
        As in :class:`estimator.slam.models.epoch_paths.EpochPaths`.
    clutter : ndarray, shape (K,)
        Density of paths that no known feature gives, per metre.
    """

    flash: Array
    noise: Array
    new_density: float
    number: NDArray[np.int64]
    length_m: Array
    std_m: Array
    clutter: Array


@compiled
def is_explained(
    layout: Layout, hypotheses: Hypotheses, seen: Array, noise: Array, gate_sigma: float, least_share: float
) -> bool:
    """Whether some hypothesis has walls for enough flashes; axes are the expected gauge frame's."""
    index, value = np.empty(FLASH_ENTRIES, dtype=np.int64), np.empty((2, FLASH_ENTRIES))
    first, second = np.empty(hypotheses.mean.shape[1]), np.empty(hypotheses.mean.shape[1])
    for r in range(hypotheses.mean.shape[0]):
        explained = 0
        for j in range(seen.shape[0]):
            for i in range(layout.slots):
                if not hypotheses.present[r, i]:
                    continue
                square, _ = flash_cost(
                    layout,
                    hypotheses.mean[r],
                    hypotheses.covariance[r],
                    i,
                    seen[j, 0],
                    seen[j, 1],
                    noise[j],
                    index,
                    value,
                    first,
                    second,
                )
                if square < gate_sigma**2:
                    explained += 1
                    break
        if explained >= least_share * seen.shape[0]:
            return True
    return False


@compiled
def place_scores(layout: Layout, known: Known, cells: Array, cell_m: float, seen: Seen) -> Array:
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
    seen : Seen
        Flashes and paths.
    """
    mean, present, located = known
    first = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    blur = cell_m * cell_m / 6.0  # of a place within its cell, and what it does to a distance
    flashes, slots = seen.flash.shape[0], layout.slots
    range_m, along = np.empty(flashes), np.empty(flashes)
    by_range, by_angle, base = np.empty(flashes), np.empty(flashes), np.empty(flashes)
    for j in range(flashes):
        x, y = seen.flash[j, 0], seen.flash[j, 1]
        size = max(np.hypot(x, y), _LEAST_M)
        nx, ny = x / size, y / size
        xx, xy, yy = seen.noise[j, 0, 0], seen.noise[j, 0, 1], seen.noise[j, 1, 1]
        by_range[j] = 0.25 * (nx * nx * xx + 2.0 * nx * ny * xy + ny * ny * yy) + blur
        by_angle[j] = (ny * ny * xx - 2.0 * nx * ny * xy + nx * nx * yy) / (size * size)
        base[j] = -0.5 * np.log(by_range[j] * by_angle[j]) - np.log(2.0 * np.pi * seen.new_density)
        range_m[j], along[j] = 0.5 * size - mean[ECHO_BIAS], np.arctan2(y, x)
    normal, offset, bearing = np.empty((slots, 2)), np.empty(slots), np.empty(slots)
    for i in range(slots):
        x, y = mean[first + 2 * i], mean[first + 2 * i + 1]
        size = max(np.hypot(x, y), _LEAST_M)
        normal[i, 0], normal[i, 1], offset[i], bearing[i] = x / size, y / size, 0.5 * size, np.arctan2(y, x)
    score = np.zeros(cells.shape[0])
    for cell in range(cells.shape[0]):
        px, py = cells[cell, 0], cells[cell, 1]
        for j in range(flashes):
            best = 0.0
            for i in range(slots):
                if not present[i]:
                    continue
                reach = offset[i] - normal[i, 0] * px - normal[i, 1] * py
                gap = abs(reach) - range_m[j]
                if gap * gap > FAR * by_range[j]:
                    continue
                off = wrapped(along[j] - bearing[i] - (0.0 if reach >= 0.0 else np.pi))
                own = base[j] - 0.5 * (gap * gap / by_range[j] + off * off / by_angle[j])
                best = max(best, own)
            score[cell] += best
        for k in range(layout.anchors):
            if not located[k]:
                continue
            a = FIRST_ANCHOR + PER_ANCHOR * k
            dx, dy = mean[a] - px, mean[a + 1] - py
            length = (1.0 + mean[a + 4]) * np.sqrt(max(dx * dx + dy * dy + mean[a + 2], 0.0)) + mean[a + 3]
            best = 0.0
            for m in range(seen.number[k]):
                variance = seen.std_m[k, m] ** 2 + blur
                gap = seen.length_m[k, m] - length
                if gap * gap < FAR * variance:
                    own = -0.5 * gap * gap / variance - np.log(
                        np.sqrt(2.0 * np.pi * variance) * seen.clutter[k]
                    )
                    best = max(best, own)
            score[cell] += best
    return score


def relocated(
    state: GaussianState,
    sweep: Sequence[GaussianVrp],
    paths: EpochPaths,
    clutter: Array,
    new_density: float,
    model: Relocation,
    visibility: Visibility,
    speed_std_m_s: float,
    trusted: bool,
    driven: bool,
) -> Hypotheses | None:
    """Hypotheses of the agent elsewhere in its map; none where the sweep is explained.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses; their weights sum to one.
    sweep : sequence of GaussianVrp
        The agent's mirror images relative to the agent, in its axes.
    paths : EpochPaths
        The paths of the same epoch; they tell whether the agent's axes are those of the start.
    clutter : ndarray, shape (K,)
        Density of paths that no known feature gives, per metre.
    new_density : float
        Density of flashes of unknown walls, per metre of range and radian.
    model : Relocation
        When, and where.
    visibility : Visibility
        What is visible there is not known.
    speed_std_m_s : float
        Standard deviation of the agent's velocity there, per axis, metres a second.
    trusted : bool
        Whether the run was right until now by its own judgement; otherwise no sweep is explained.
    driven : bool
        Whether odometry tells how the agent moves: then it matters which way its body stands, which it may
        any way.
    """
    layout, hypotheses = state.layout, state.hypotheses
    to_gauge = rotation_matrix(-state.bearing_rad)
    flash = np.array([wall.mean_m for wall in sweep]) @ to_gauge.T
    noise = np.array([to_gauge @ wall.covariance_m2 @ to_gauge.T for wall in sweep])
    held = paths.heading_held
    if trusted and (
        not held
        or is_explained(layout, hypotheses, flash, noise, model.explained_sigma, model.explained_share)
    ):
        return None
    known = map_of(state)
    if not known.present.any():
        return None
    cells, cell_m = grid(layout, known, model)
    turns = np.array([-known.mean[THETA]]) if held else _headings(layout, known, flash, model)
    score = np.full(len(cells), -np.inf)
    for turn in turns.tolist():
        rotation = rotation_matrix(turn)
        seen = Seen(
            flash @ rotation.T,
            rotation @ noise @ rotation.T,
            new_density,
            paths.number,
            paths.length_m,
            paths.std_m,
            clutter,
        )
        own = place_scores(layout, known, cells, cell_m, seen)
        score = np.maximum(score, own)
    best = Places(cells[best_places(cells, score, model)], cell_m, len(cells))
    found = elsewhere(state, best, model.place_std_m, model, visibility, speed_std_m_s)
    return _any_way_round(found, model.most_headings) if driven else found


def _any_way_round(hypotheses: Hypotheses, headings: int) -> Hypotheses:
    """The hypotheses, the agent's body standing any way round, each way one of its own."""
    step = 2.0 * np.pi / headings
    turned = hypotheses.take(np.tile(np.arange(hypotheses.number), headings))
    turned.log_weight[...] -= np.log(headings)
    turned.mean[:, HEADING] = np.repeat(np.arange(headings) * step, hypotheses.number)
    turned.covariance[:, HEADING, :], turned.covariance[:, :, HEADING] = 0.0, 0.0
    turned.covariance[:, HEADING, HEADING] = (0.5 * step) ** 2
    return turned


def _headings(layout: Layout, known: Known, flash: Array, model: Relocation) -> Array:
    """Turns of the agent's axes that pair flashes and walls best, by votes."""
    vrps = known.mean[layout.walls].reshape(-1, 2)[known.present]
    walls = np.arctan2(vrps[:, 1], vrps[:, 0])
    turns = np.arctan2(flash[:, 1], flash[:, 0])[:, None] - np.concatenate([walls, walls + np.pi])
    width = 2.0 * np.pi / model.heading_bins
    bins = (np.mod(-turns, 2.0 * np.pi) / width).astype(np.int64) % model.heading_bins
    votes = np.bincount(bins.ravel(), minlength=model.heading_bins)
    return np.asarray((np.argsort(-votes, kind="stable")[: model.most_headings] + 0.5) * width)
