"""Where in its map the agent may be: the map, a grid over it, its best places, and hypotheses of them.

Shared by what finds the agent by a sweep (:mod:`estimator.slam.gaussian.relocation`) and by paths alone
(:mod:`estimator.slam.gaussian.path_relocation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.settings import Settings, not_negative, positive, probability, share
from estimator.slam.models.state_vector import AGENT, Layout
from estimator.slam.models.visibility import Visibility, prior_visibility

__all__ = ["FAR", "Known", "Places", "Relocation", "best_places", "elsewhere", "grid", "map_of"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FAR: Final = 30.0  # numerical floor: squared standard deviations beyond which a density counts as nothing


@dataclass(frozen=True)
class Relocation(Settings):
    """When and where the agent is looked for in the map.

    Parameters
    ----------
    elsewhere_probability : float
        Probability that, since the epoch before, the agent was put anywhere else in the mapped area.
    explained_share : float
        A sweep is explained where known walls give at least this share of its flashes,
    explained_sigma : float
        within so many standard deviations.
    place_std_m, path_place_std_m : float
        Standard deviation per axis of a place found on the grid, by a sweep and by paths alone, metres.
    cell_m : float
        Size of a cell, metres; larger where there would be more than ``most_cells``.
    most_cells : int
        Bound of the cells.
    most_places : int
        Places that become hypotheses,
    apart_m : float
        so far apart at least, metres,
    worse_nats : float
        and no more than this worse than the best.
    retry_epochs : int
        While a run is suspect and sweeps do not come often, it is looked for by paths: at once, then after
        twice as many epochs each time, up to so many.
    margin_m : float
        How far the mapped area reaches beyond its walls and anchors, metres.
    most_headings : int
        Headings tried: of the axes where they are not held, of the body where odometry is measured.
    heading_bins : int
        Parts of the circle in which headings of the axes are voted for.
    """

    elsewhere_probability: float = probability(1e-8)
    explained_share: float = share(0.75)
    explained_sigma: float = positive(4.0)
    place_std_m: float = positive(0.5)
    path_place_std_m: float = positive(0.25)
    retry_epochs: int = positive(16)
    cell_m: float = positive(0.25)
    most_cells: int = positive(40_000)
    most_places: int = positive(8)
    apart_m: float = positive(1.0)
    worse_nats: float = positive(15.0)
    margin_m: float = not_negative(2.0)
    most_headings: int = positive(8)
    heading_bins: int = positive(120)


class Known(NamedTuple):
    """The map in which the agent is looked for: the likeliest hypothesis's.

    Parameters
    ----------
    mean : ndarray, shape (n,)
        A state vector, whose agent is not looked at.
    present, located : ndarray of bool, shapes (L,) and (K,)
        Confirmed walls and anchors that it has.
    """

    mean: Array
    present: Mask
    located: Mask


class Places(NamedTuple):
    """Places of a grid over the map.

    Parameters
    ----------
    place_m : ndarray, shape (C, 2)
        Places, gauge frame, metres.
    cell_m : float
        Size of a cell of the grid, metres,
    cells : int
        and how many there are.
    """

    place_m: Array
    cell_m: float
    cells: int


def map_of(state: GaussianState) -> Known:
    """The map of the likeliest hypothesis."""
    hypotheses, best = state.hypotheses, state.hypotheses.best
    present = hypotheses.present[best] & state.slots.confirmed
    return Known(hypotheses.mean[best], present, hypotheses.located[best])


def grid(layout: Layout, known: Known, model: Relocation) -> tuple[Array, float]:
    """Cells (C, 2) over the mapped area, and how far they are apart, metres."""
    mean, present, located = known
    feet = 0.5 * mean[layout.walls].reshape(-1, 2)[present]
    anchors = np.array([mean[layout.anchor_xy(k)] for k in np.flatnonzero(located).tolist()]).reshape(-1, 2)
    points = np.concatenate([feet, anchors, mean[None, :2], np.zeros((1, 2))])
    low, high = points.min(axis=0) - model.margin_m, points.max(axis=0) + model.margin_m
    cell_m = max(model.cell_m, float(np.sqrt(np.prod(high - low) / model.most_cells)))
    x, y = (np.arange(low[a] + 0.5 * cell_m, high[a], cell_m) for a in range(2))
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2), cell_m


def best_places(cells: Array, score: Array, model: Relocation) -> NDArray[np.int64]:
    """Cells of the best places, apart from one another."""
    chosen: list[int] = []
    left = score.copy()
    while len(chosen) < model.most_places:
        best = int(np.argmax(left))
        if not left[best] > score.max() - model.worse_nats:
            break
        chosen.append(best)
        left[np.linalg.norm(cells - cells[best], axis=1) < model.apart_m] = -np.inf
    return np.array(chosen, dtype=np.int64)


def elsewhere(
    state: GaussianState,
    places: Places,
    std_m: float,
    model: Relocation,
    visibility: Visibility,
    speed_std_m_s: float,
) -> Hypotheses:
    """The likeliest hypothesis with its agent at other places of a grid, each with its prior probability.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses.
    places : Places
        Where.
    std_m : float
        Standard deviation of a place per axis, metres.
    model : Relocation
        How probably the agent is elsewhere at all.
    visibility : Visibility
        What is visible there is not known.
    speed_std_m_s : float
        Standard deviation of the agent's velocity there, per axis, metres a second.
    """
    hypotheses = state.hypotheses
    found = hypotheses.take(np.full(len(places.place_m), hypotheses.best))
    share = 2.0 * np.pi * std_m**2 / (places.cells * places.cell_m**2)
    found.log_weight[...] = np.log(model.elsewhere_probability * share)
    found.mean[:, :2], found.mean[:, 2:4] = places.place_m, 0.0
    found.covariance[:, AGENT, :], found.covariance[:, :, AGENT] = 0.0, 0.0
    found.covariance[:, AGENT, AGENT] = np.diag([std_m**2] * 2 + [speed_std_m_s**2] * 2)
    found.visibility[...] = prior_visibility(state.layout, visibility)
    return found
