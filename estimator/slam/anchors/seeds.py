"""Where pairs of circles of the present epoch meet, and which of these places explain most paths.

Bounds of one search: ``pairs`` intersections of two circles over all clock biases, each scored against the
circles of up to one bounce; ``scored`` of them against all circles; ``refined`` of each bias are chosen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.cells import Cells, SearchLimits
from estimator.slam.anchors.circles import Circles, intersect
from estimator.slam.anchors.likelihood import Model, Place, gate_epoch, is_behind, room_for
from estimator.slam.anchors.observations import Observations

__all__ = ["apart", "choose_seeds", "paired"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_SHORTEST_M = 1e-3  # numerical floor of a radius, whatever the clock says


def choose_seeds(
    circles: Circles,
    seen: Observations,
    cells: Cells,
    vrp: Array,
    model: Model,
    limits: SearchLimits,
    radius: float,
    touch: float,
) -> tuple[Array, Array, Index]:
    """The intersections, x, y and cell (S,), that explain the last epoch best, ``radius`` metres apart.

    Where there are more pairs than allowed, the walls that are farthest and the paths that are known worst,
    and among those the longest, are left out: what comes over more than one bounce is long, and clutter is
    anywhere.

    Parameters
    ----------
    circles, seen, cells, vrp, model, limits : NamedTuples and arrays
        Circles, paths, what is tried, walls (L, 2), numbers, bounds.
    radius : float
        Of seeds of one cell that are closer than this the better one stands for both, metres.
    touch : float
        As in :func:`estimator.slam.anchors.circles.intersect`.
    """
    centre, path = paired(circles, seen, min(limits.pairs, limits.pairs_in_all // len(cells.bias_m)), limits)
    x, y, cell = _intersections(circles, seen, cells, centre, path, touch)
    score = cells.log_prior[cell]
    single, every = 1 + circles.walls, circles.x.shape[1]
    _add_scores(score, x, y, cell, circles, seen, cells, 0, single, vrp, model)
    if len(x) > limits.scored:
        order = np.argsort(-score, kind="stable")[: limits.scored]
        x, y, cell, score = x[order], y[order], cell[order], score[order]
    _add_scores(score, x, y, cell, circles, seen, cells, single, every, vrp, model)
    order = np.argsort(-score, kind="stable")
    point = np.stack([x, y, 2.0 * radius * cell], axis=1)  # those of different cells are never the same
    kept = apart(point, order, radius, cell, limits.refined, limits.refined_in_all)
    return x[kept], y[kept], cell[kept]


def paired(circles: Circles, seen: Observations, most: int, limits: SearchLimits) -> tuple[Index, Index]:
    """The centres and the paths of the last epoch that are paired, of which pairs are about ``most``."""
    centre, path = np.arange(1 + circles.walls), np.arange(seen.paths[-1])
    if _pairs(centre.size) * 2 * _pairs(path.size) <= most:
        return centre, path
    least = min(limits.paired_paths, path.size)
    count = max(_side(most / max(2 * _pairs(least), 1)), limits.paired_circles)
    gap = np.hypot(circles.x[-1, centre] - circles.x[-1, 0], circles.y[-1, centre] - circles.y[-1, 0])
    centre = np.argsort(gap, kind="stable")[:count]
    order = np.argsort(seen.length_variance_m2[-1, : path.size], kind="stable")
    return centre, np.sort(order[: _side(most / max(2 * _pairs(centre.size), 1))])


def _pairs(count: int) -> int:
    """Unordered pairs of so many things."""
    return count * (count - 1) // 2


def _side(pairs: float) -> int:
    """The largest number of things, at least two, of which there are no more unordered pairs."""
    return max(int(0.5 + np.sqrt(0.25 + 2.0 * pairs)), 2)


@compiled
def _intersections(
    circles: Circles, seen: Observations, cells: Cells, centre: Index, path: Index, touch: float
) -> tuple[Array, Array, Index]:
    """Where circles of the last epoch of some centres and paths meet: x, y and cell (S,)."""
    e, kinds, count = len(circles.x) - 1, len(cells.bias_m), len(path)
    size = kinds * len(centre) * (len(centre) - 1) * count * max(count - 1, 0)
    px, py, cell = np.empty(size), np.empty(size), np.empty(size, dtype=np.int64)
    n = 0
    radius = np.empty(count)
    for g in range(kinds):
        for i in range(count):
            flat = seen.length_m[e, path[i]] - cells.bias_m[g]
            radius[i] = np.sqrt(max(flat * abs(flat) - cells.height2_m2[g], _SHORTEST_M**2))
        for a in range(len(centre)):
            ax, ay = circles.x[e, centre[a]], circles.y[e, centre[a]]
            for b in range(a + 1, len(centre)):
                bx, by = circles.x[e, centre[b]], circles.y[e, centre[b]]
                for i in range(count):
                    for j in range(count):
                        if i == j:
                            continue
                        x0, y0, x1, y1 = intersect(ax, ay, radius[i], bx, by, radius[j], touch)
                        if np.isfinite(x0):
                            px[n], py[n], cell[n] = x0, y0, g
                            px[n + 1], py[n + 1], cell[n + 1] = x1, y1, g
                            n += 2
    return px[:n], py[:n], cell[:n]


@compiled
def _add_scores(
    score: Array,
    px: Array,
    py: Array,
    cell: Index,
    circles: Circles,
    seen: Observations,
    cells: Cells,
    first: int,
    last: int,
    vrp: Array,
    model: Model,
) -> None:
    """Add the log chances of the last epoch's paths under circles ``first`` to ``last``, each on its own."""
    e, out = len(circles.x) - 1, room_for(circles.x.shape[1], model.max_gated)
    silent, nothing = np.empty(last), 0.0  # what each circle says if it explains nothing
    for q in range(first, last):
        silent[q] = np.log1p(-model.visibility[q] * model.detection_probability)
        nothing += silent[q]
    for s in range(len(px)):
        g = cell[s]
        place = Place(px[s], py[s], cells.bias_m[g], cells.height2_m2[g], cells.height2_std_m2[g])
        total = nothing
        for q in range(max(first, 1), min(last, 1 + circles.walls)):
            if is_behind(px[s], py[s], vrp[q - 1, 0], vrp[q - 1, 1]):
                total -= silent[q]
        if gate_epoch(place, circles, seen, e, first, last, vrp, model, out):
            product = 1.0
            for q in range(first, last):
                if out.begin[q] < out.begin[q + 1]:
                    told = 0.0
                    for i in range(out.begin[q], out.begin[q + 1]):
                        told += out.relative[i]
                    chance = model.visibility[q] * model.detection_probability
                    product *= 1.0 + chance * (told - 1.0)
                    total -= silent[q]
                    if not 1e-100 < product < 1e100:  # one logarithm for many factors
                        total += np.log(product)
                        product = 1.0
            total += np.log(product)
        score[s] += total


@compiled
def apart(point: Array, order: Index, radius: float, group: Index, most: int, most_in_all: int) -> Index:
    """The first of the points (S, 3) in ``order`` that are further than ``radius`` from those before.

    At most ``most`` of each group (S,) and ``most_in_all``.
    """
    taken = np.zeros(group.max() + 1 if len(group) else 0, dtype=np.int64)
    kept = np.empty(min(len(order), most_in_all), dtype=np.int64)
    count = 0
    for s in order:
        if count == len(kept):
            break
        alone = taken[group[s]] < most
        for j in range(count):
            if not alone:
                break
            dx, dy = point[kept[j], 0] - point[s, 0], point[kept[j], 1] - point[s, 1]
            dz = point[kept[j], 2] - point[s, 2]
            alone = dx * dx + dy * dy + dz * dz > radius * radius
        if alone:
            kept[count] = s
            taken[group[s]] += 1
            count += 1
    return kept[:count]
