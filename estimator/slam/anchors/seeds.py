"""Where pairs of circles of the present epoch meet, and which of these places explain most paths.

Bounds of one search: ``pairs`` intersections of two circles over all clock biases, each scored against the
circles of up to one bounce; ``scored`` of them against all circles; ``refined`` of each bias are chosen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles, intersect
from estimator.slam.anchors.likelihood import Model, Place, gate_circle, is_behind
from estimator.slam.anchors.observations import Observations

__all__ = ["Cells", "SearchLimits", "choose_seeds"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_SHORTEST_M = 1e-3  # numerical floor of a radius, whatever the clock says


class Cells(NamedTuple):
    """The clock biases and squared heights that a search tries, G of them.

    Parameters
    ----------
    bias_m, height2_m2 : ndarray, shape (G,)
        Clock bias, metres, and squared height difference, square metres.
    log_prior : ndarray, shape (G,)
        Log prior probability.
    """

    bias_m: Array
    height2_m2: Array
    log_prior: Array


class SearchLimits(NamedTuple):
    """What a search may cost: see :class:`AnchorSearchConfig`.

    Parameters
    ----------
    pairs, pairs_in_all : int
        Pairs of circles that are intersected, of one cell and of all.
    scored : int
        Intersections that are scored with double bounces.
    refined, refined_in_all : int
        Intersections that are chosen, of one cell and of all.
    """

    pairs: int
    pairs_in_all: int
    scored: int
    refined: int
    refined_in_all: int


@compiled
def _score(
    place: Place,
    circles: Circles,
    seen: Observations,
    widest: Array,
    first: int,
    last: int,
    vrp: Array,
    model: Model,
    path: Index,
    relative: Array,
) -> float:
    """Log of the chance of the last epoch's paths under circles ``first`` to ``last``, each on its own."""
    total = 0.0
    e, pd = len(circles.x) - 1, model.detection_probability
    for q in range(first, last):
        if 0 < q <= circles.walls and is_behind(place.x, place.y, vrp[q - 1, 0], vrp[q - 1, 1]):
            continue
        kind = 0 if q == 0 else (1 if q <= circles.walls else 2)
        chance = model.visibility[kind] * pd
        told = 0.0
        for i in range(gate_circle(place, circles, seen, widest, e, q, model, path, relative)):
            told += relative[i]
        total += np.log1p(chance * (told - 1.0))
    return total


@compiled
def _affordable_paths(count: int, circles: int, most: int) -> int:
    """How many of ``count`` paths can be paired on ``circles`` circles with ``most`` pairs; at least two."""
    while count > 2 and circles * (circles - 1) // 2 * count * (count - 1) > most:
        count -= 1
    return count


@compiled
def _intersections(
    circles: Circles, seen: Observations, cells: Cells, limits: SearchLimits, touch: float
) -> tuple[Array, Array, Index]:
    """Where circles of the last epoch meet: x, y and cell (S,).

    Where there are more pairs than allowed, the walls that are farthest and the paths that are known worst,
    and among those the longest, are left out: what comes over more than one bounce is long, and clutter is
    anywhere.
    """
    e, kinds = len(circles.x) - 1, len(cells.bias_m)
    most = max(min(limits.pairs, limits.pairs_in_all // kinds), 1)
    used = 1 + circles.walls
    while used > 2 and used * (used - 1) > most:
        used -= 1
    count = _affordable_paths(seen.paths[e], used, most)
    centre = np.arange(1 + circles.walls)
    if used < centre.size:
        x, y = circles.x[e, : centre.size], circles.y[e, : centre.size]
        centre = np.argsort((x - x[0]) ** 2 + (y - y[0]) ** 2, kind="mergesort")[:used]
    chosen = np.arange(seen.paths[e])
    if count < chosen.size:
        order = np.argsort(seen.length_variance_m2[e, : chosen.size], kind="mergesort")
        chosen = np.sort(order[:count])
    size = kinds * used * (used - 1) * count * max(count - 1, 0)
    px, py, cell = np.empty(size), np.empty(size), np.empty(size, dtype=np.int64)
    n = 0
    for g in range(kinds):
        for a in range(used):
            for i in range(count):
                ca, radius = centre[a], seen.length_m[e, chosen[i]] - cells.bias_m[g]
                ra = np.sqrt(max(radius * abs(radius) - cells.height2_m2[g], _SHORTEST_M**2))
                for b in range(a + 1, used):
                    cb = centre[b]
                    for j in range(count):
                        if i == j:
                            continue
                        radius = seen.length_m[e, chosen[j]] - cells.bias_m[g]
                        rb = np.sqrt(max(radius * abs(radius) - cells.height2_m2[g], _SHORTEST_M**2))
                        x0, y0, x1, y1 = intersect(
                            circles.x[e, ca],
                            circles.y[e, ca],
                            ra,
                            circles.x[e, cb],
                            circles.y[e, cb],
                            rb,
                            touch,
                        )
                        if np.isfinite(x0):
                            px[n], py[n], cell[n] = x0, y0, g
                            px[n + 1], py[n + 1], cell[n + 1] = x1, y1, g
                            n += 2
    return px[:n], py[:n], cell[:n]


@compiled
def choose_seeds(
    circles: Circles,
    seen: Observations,
    widest: Array,
    cells: Cells,
    vrp: Array,
    model: Model,
    limits: SearchLimits,
    radius: float,
    touch: float,
) -> tuple[Array, Array, Index]:
    """The intersections, x, y and cell (S,), that explain the last epoch best, ``radius`` metres apart.

    Parameters
    ----------
    circles, seen, widest, cells, vrp, model, limits : NamedTuples and arrays
        Circles, paths, the largest variance (E,) of each epoch's paths, what is tried, walls (L, 2),
        numbers, bounds.
    radius : float
        Of seeds of one cell that are closer than this the better one stands for both, metres.
    touch : float
        As in :func:`estimator.slam.anchors.circles.intersect`.
    """
    px, py, cell = _intersections(circles, seen, cells, limits, touch)
    path, relative = np.empty(model.max_gated, dtype=np.int64), np.empty(model.max_gated)
    score = np.empty(len(px))
    single, every = 1 + circles.walls, circles.x.shape[1]
    for s in range(len(px)):
        place = Place(px[s], py[s], cells.bias_m[cell[s]], cells.height2_m2[cell[s]])
        score[s] = _score(place, circles, seen, widest, 0, single, vrp, model, path, relative)
    if len(px) > limits.scored:
        order = np.argsort(-(score + cells.log_prior[cell]), kind="mergesort")[: limits.scored]
        px, py, cell, score = px[order], py[order], cell[order], score[order]
    for s in range(len(px)):
        place = Place(px[s], py[s], cells.bias_m[cell[s]], cells.height2_m2[cell[s]])
        score[s] += _score(place, circles, seen, widest, single, every, vrp, model, path, relative)
    order = np.argsort(-(score + cells.log_prior[cell]), kind="mergesort")
    taken = np.zeros(len(cells.bias_m), dtype=np.int64)
    kept = np.empty(min(len(px), limits.refined_in_all), dtype=np.int64)
    count = 0
    for i in range(len(order)):
        s = order[i]
        if count == limits.refined_in_all:
            break
        if taken[cell[s]] == limits.refined:
            continue
        alone = True
        for j in range(count):
            t = kept[j]
            if cell[t] == cell[s] and (px[t] - px[s]) ** 2 + (py[t] - py[s]) ** 2 <= radius * radius:
                alone = False
                break
        if alone:
            kept[count] = s
            taken[cell[s]] += 1
            count += 1
    kept = kept[:count]
    return px[kept], py[kept], cell[kept]
