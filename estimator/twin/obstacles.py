"""Obstacles by their shadows: boxes that silent paths would have crossed, and heard ones never do.

Columns and furniture reflect too little, and too seldom, for a wall to be found; but they hide
anchors and walls. Every path that the finite walls would give, and that was not heard, was hidden somewhere
along
its legs. Where nothing that was heard ever passed, boxes are grown that hide as many such paths
as possible and none that was heard.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from estimator.geometry import rotate
from estimator.slam.models.settings import Settings, positive
from estimator.twin.boxes import Legs, crosses_box
from estimator.twin.sightings import Sightings

__all__ = ["Obstacle", "ShadowSearch", "find_obstacles", "legs_of"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_STEPS_M = (0.4, 0.2, 0.1, 0.05, 0.02)


@dataclass(frozen=True)
class ShadowSearch(Settings):
    """How obstacles are looked for.

    Parameters
    ----------
    cell_m : float
        Cells of the map of where heard paths passed.
    silent, heard_single, heard_double : float
        What a silent path that is not hidden costs, and a heard one that is, nats.
    least_heard : float
        Where less than this share of the double bounces (or of the other paths) that walls would give is
        heard at all, silence of one tells as much less: a receiver may resolve none.
    walked : float
        An obstacle where the agent walked, or an anchor stands.
    clearance_m : float
        Half the width that either needs.
    perimeter_per_m : float
        What a metre of an obstacle's outline costs: the smallest box that explains as much.
    least_gain : float
        An obstacle is worth at least this, nats: a few silent paths have other reasons.
    largest_m : float
        Boxes are not wider: larger ones are walls.
    most : int
        Obstacles at most.
    """

    cell_m: float = positive(0.1)
    silent: float = positive(0.5)
    heard_single: float = positive(1.0)
    heard_double: float = positive(0.4)
    least_heard: float = positive(0.25)
    walked: float = positive(20.0)
    clearance_m: float = positive(0.15)
    perimeter_per_m: float = positive(0.3)
    least_gain: float = positive(3.0)
    largest_m: float = positive(4.0)
    most: int = positive(60)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A box that hides.

    Parameters
    ----------
    corners_m : ndarray, shape (4, 2)
        Corners in order, estimator's frame.
    existence : float
        Probability that it is there.
    hidden : int
        Silent paths that it explains.
    """

    corners_m: Array
    existence: float
    hidden: int


def legs_of(sights: Sightings, which: Mask, weight: Array) -> Legs:
    """The legs of some paths (T, K, F), weighed alike (broadcast)."""
    vertex = sights.unfolded.vertex_m[which]
    ends = np.stack([vertex[:, :-1], vertex[:, 1:]], axis=2)
    path = np.broadcast_to(np.arange(len(vertex))[:, None], ends.shape[:2])
    each = np.broadcast_to(np.broadcast_to(weight, which.shape)[which][:, None], ends.shape[:2])
    there = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1) > 1e-9
    return Legs(ends[there], path[there], each[there])


def find_obstacles(
    sights: Sightings, expected: Mask, axis_rad: float, config: ShadowSearch | None = None
) -> list[Obstacle]:
    """Find boxes along an axis.

    Parameters
    ----------
    sights : Sightings
        What was heard.
    expected : ndarray of bool, shape (T, K, F)
        Paths that walls with their ends would give.
    axis_rad : float
        Direction of the boxes' sides: that of the walls.
    config : ShadowSearch, optional
        How.

    Returns
    -------
    list of Obstacle
        The one that explains most first.
    """
    config = config or ShadowSearch()
    double = np.sum(sights.unfolded.walls >= 0, axis=1) > 1
    price = np.where(double, config.heard_double, config.heard_single) * sights.weight
    heard = _turned(legs_of(sights, sights.heard & expected, price), -axis_rad)
    quiet = config.silent * _audible(sights, expected, double, config.least_heard)
    silent = _turned(legs_of(sights, sights.silent & expected, quiet), -axis_rad)
    if _weight(silent, np.ones(len(silent.path), dtype=bool)) < config.least_gain or not len(heard.path):
        return []
    for taken in (_walked(sights, config), _stood(sights, config)):
        heard = heard.joined(_turned(taken, -axis_rad))
    low = heard.ends_m.reshape(-1, 2).min(axis=0) - config.cell_m
    shape = np.ceil((heard.ends_m.reshape(-1, 2).max(axis=0) + config.cell_m - low) / config.cell_m)
    size = (int(shape[0]), int(shape[1]))
    passed = _passes(heard, low, size, config.cell_m)
    free = passed > config.heard_single
    boxes: list[Array] = []
    rejected, left = np.zeros(size, dtype=bool), silent
    while len(boxes) < config.most and len(left.path):
        shade = np.where(free | rejected, 0.0, _passes(left, low, size, config.cell_m))
        seed = _seed(shade)
        if seed is None or shade.max() < 0.5 * config.least_gain:  # about: cells are sampled
            break
        corner = low + np.array(seed) * config.cell_m
        box = _grown(np.concatenate([corner, corner + config.cell_m]), heard, left, config)
        rejected |= ndimage.binary_dilation(_only(seed, size), iterations=2)
        if -_cost(box, heard, left, 0.0) >= config.least_gain:
            boxes.append(box)
            left = _unexplained(left, [box])
    found = []
    for i, box in enumerate(boxes):
        mine = _unexplained(silent, [*boxes[:i], *boxes[i + 1 :]])
        boxes[i] = _centred(_grown(box, heard, mine, config), heard, mine, config)
        hidden = np.unique(silent.path[crosses_box(silent.ends_m, boxes[i])])
        x0, y0, x1, y1 = boxes[i]
        corners = rotate(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), axis_rad)
        gain = max(-_cost(boxes[i], heard, mine, 0.0), 0.0)
        found.append(Obstacle(corners, float(1.0 - 0.5 * np.exp(-gain)), len(hidden)))
    return sorted(found, key=lambda obstacle: -obstacle.hidden)


def _audible(sights: Sightings, expected: Mask, double: Mask, least: float) -> Array:
    """How far silence of each feature (F,) tells of obstacles: not at all if such paths are never heard."""
    share = np.ones(len(double))
    for kind in (double, ~double):
        heard, silent = ((which & expected)[:, :, kind].sum() for which in (sights.heard, sights.silent))
        share[kind] = min(heard / max(heard + silent, 1) / least, 1.0)
    return share


def _walked(sights: Sightings, config: ShadowSearch) -> Legs:
    """The agent's own way, which nothing stands in, and its width beside it."""
    track = sights.unfolded.vertex_m[:, 0, 0, -1]
    ends = np.stack([track[:-1], track[1:]], axis=1)
    along = ends[:, 1] - ends[:, 0]
    size = np.linalg.norm(along, axis=1)
    ends, along = ends[size > 0.0], along[size > 0.0] / size[size > 0.0, None]
    across = config.clearance_m * np.stack([-along[:, 1], along[:, 0]], axis=1)[:, None]
    every = np.concatenate([ends - across, ends, ends + across])
    return Legs(every, np.arange(len(every)), np.full(len(every), config.walked))


def _stood(sights: Sightings, config: ShadowSearch) -> Legs:
    """Where anchors are, and as much space around them."""
    anchors = sights.unfolded.vertex_m[0, :, 0, 0]
    arms = config.clearance_m * np.array([[[-1.0, 0.0], [1.0, 0.0]], [[0.0, -1.0], [0.0, 1.0]]])
    every = (anchors[:, None, None] + arms).reshape(-1, 2, 2)
    return Legs(every, np.arange(len(every)), np.full(len(every), config.walked))


def _unexplained(silent: Legs, boxes: list[Array]) -> Legs:
    """Legs of the silent paths that none of some boxes hides."""
    for box in boxes:
        hidden = silent.path[crosses_box(silent.ends_m, box)]
        silent = silent.select(~np.isin(silent.path, hidden))
    return silent


def _turned(legs: Legs, angle_rad: float) -> Legs:
    return Legs(rotate(legs.ends_m, angle_rad), legs.path, legs.weight)


def _passes(legs: Legs, low: Array, size: tuple[int, int], cell_m: float) -> Array:
    """Weight of the paths that pass each cell of a grid, about."""
    length = np.linalg.norm(legs.ends_m[:, 1] - legs.ends_m[:, 0], axis=1)
    count = np.maximum(np.ceil(2.0 * length / cell_m).astype(np.int64), 1)
    leg = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(leg)) - np.repeat(np.cumsum(count) - count, count)
    share = ((step + 0.5) / count[leg])[:, None]
    point = legs.ends_m[leg, 0] + share * (legs.ends_m[leg, 1] - legs.ends_m[leg, 0])
    cell = np.floor((point - low) / cell_m).astype(np.int64)
    inside = np.all((cell >= 0) & (cell < size), axis=1)
    flat = cell[inside, 0] * size[1] + cell[inside, 1]
    weight = 0.5 * legs.weight[leg[inside]]  # about two samples in each cell
    return np.asarray(np.bincount(flat, weight, minlength=size[0] * size[1]), np.float64).reshape(size)


def _seed(shade: Array) -> tuple[int, int] | None:
    """The cell that most silent paths would have passed, its neighbours counting half."""
    if not shade.any():
        return None
    blurred = ndimage.convolve(shade, np.array([[0.25, 0.5, 0.25], [0.5, 1.0, 0.5], [0.25, 0.5, 0.25]]))
    x, y = np.unravel_index(int(np.argmax(np.where(shade > 0.0, blurred, 0.0))), shade.shape)
    return int(x), int(y)


def _only(cell: tuple[int, int], size: tuple[int, int]) -> Mask:
    mask = np.zeros(size, dtype=bool)
    mask[cell] = True
    return mask


def _cost(box: Array, heard: Legs, silent: Legs, perimeter_per_m: float) -> float:
    """What a box costs: heard paths that it hides and its outline, less the silent paths that it explains."""
    wrong = _weight(heard, crosses_box(heard.ends_m, box))
    right = _weight(silent, crosses_box(silent.ends_m, box))
    return wrong - right + perimeter_per_m * 2.0 * float(np.sum(box[2:] - box[:2]))


def _weight(legs: Legs, crossed: Mask) -> float:
    """Weight of the paths of some legs, each path once."""
    path, first = np.unique(legs.path[crossed], return_index=True)
    return float(legs.weight[crossed][first].sum()) if path.size else 0.0


def _grown(box: Array, heard: Legs, silent: Legs, config: ShadowSearch) -> Array:
    """A box whose sides are moved, in ever smaller steps, while it costs less."""
    reach = np.concatenate([box[:2] - config.largest_m, box[2:] + config.largest_m])
    near = heard.select(crosses_box(heard.ends_m, reach))
    shadows = silent.select(crosses_box(silent.ends_m, reach))
    best = _cost(box, near, shadows, config.perimeter_per_m)
    for _ in range(3):
        before = best
        for step in _STEPS_M:
            moved = True
            while moved:
                moved = False
                for side in range(4):
                    for sign in (-1.0, 1.0):
                        trial = box.copy()
                        trial[side] += sign * step
                        width = trial[2:] - trial[:2]
                        if width.min() < 0.5 * config.cell_m or width.max() > config.largest_m:
                            continue
                        cost = _cost(trial, near, shadows, config.perimeter_per_m)
                        if cost < best - 1e-9:
                            box, best, moved = trial, cost, True
        if before - best < 1e-6:
            break
    return box


def _centred(box: Array, heard: Legs, silent: Legs, config: ShadowSearch) -> Array:
    """The box with each side half-way between where it could be at least and at most."""
    limit = 0.5
    reach = np.concatenate([box[:2] - 2.0 * limit, box[2:] + 2.0 * limit])
    near = heard.select(crosses_box(heard.ends_m, reach))
    shadows = silent.select(crosses_box(silent.ends_m, reach))
    result = box.copy()
    least = _cost(box, near, shadows, 0.0)
    for side in range(4):
        outward = -1.0 if side < 2 else 1.0
        free = 0.0
        while free < limit:
            trial = box.copy()
            trial[side] += outward * (free + 0.02)
            if _cost(trial, near, shadows, 0.0) > least + 1e-9:
                break
            free += 0.02
        if free < limit:  # beyond, nothing tells where it ends
            result[side] += outward * 0.5 * free
    return result
