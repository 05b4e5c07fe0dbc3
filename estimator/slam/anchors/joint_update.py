"""The joint Kalman update by an anchor's first paths: of each hypothesis, place and labelling.

Plain arithmetic of single hypotheses: a labelling costs about m^3 / 6 operations for m labelled paths, an
update n^2 m / 2 for n state variables.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.features import mirror
from estimator.slam.models.path_lengths import length_gradient
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["BranchLimits", "PlacePaths", "updated", "weigh_labellings"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_LOG_2PI: Final = float(np.log(2.0 * np.pi))
_PER_PATH: Final = 9  # state variables that a path over one bounce depends on


class PlacePaths(NamedTuple):
    """Places of an anchor and the paths that it may be heard over.

    Parameters
    ----------
    place_m : ndarray, shape (S, 2)
        Places.
    bias_m : ndarray, shape (S,)
        Clock bias at each.
    height2_m2, height2_variance_m4 : ndarray, shape (S,)
        Squared height at each and its variance; a negative variance leaves both as the hypothesis has them.
    log_evidence : ndarray, shape (S,)
        Log weight that each brings.
    candidate : ndarray of int64, shape (V,)
        The place of each labelling, ascending.
    begin : ndarray of int64, shape (S + 1,)
        Their labellings: ``begin[s]`` to ``begin[s + 1]``.
    label : ndarray of int64, shape (V, C)
        The path of each feature, -1 for none.
    wall : ndarray of int64, shape (C,)
        The wall slot of each feature, -1 for the line of sight.
    length_m, variance_m2 : ndarray, shape (M,)
        The paths.
    clutter_density : float
        Clutter, per metre.
    """

    place_m: Array
    bias_m: Array
    height2_m2: Array
    height2_variance_m4: Array
    log_evidence: Array
    candidate: Index
    begin: Index
    label: Index
    wall: Index
    length_m: Array
    variance_m2: Array
    clutter_density: float


class BranchLimits(NamedTuple):
    """What branching may cost.

    Parameters
    ----------
    prune_nats : float
        Hypotheses this far below the best are not made.
    max_labelled : int
        Hypotheses times labellings that are weighed.
    max_branches : int
        Hypotheses that are made.
    """

    prune_nats: float
    max_labelled: int
    max_branches: int


@compiled
def _moved(layout: Layout, k: int, mean: Array, covariance: Array, places: PlacePaths, s: int) -> Array:
    """A hypothesis's mean with anchor ``k`` at place ``s``; clocks that agree move together."""
    moved, a = mean.copy(), FIRST_ANCHOR + PER_ANCHOR * k
    moved[a], moved[a + 1] = places.place_m[s, 0], places.place_m[s, 1]
    if places.height2_variance_m4[s] >= 0.0:
        moved[a + 2] = places.height2_m2[s]
    shift, scale = places.bias_m[s] - mean[a + 3], max(covariance[a + 3, a + 3], 1e-12)
    for other in range(layout.anchors):
        b = FIRST_ANCHOR + PER_ANCHOR * other + 3
        moved[b] += shift if other == k else covariance[b, a + 3] / scale * shift
    return moved


@compiled
def _path_lengths(layout: Layout, k: int, mean: Array, wall: Index) -> tuple[Array, Index, Array, Array]:
    """Lengths (C,) of paths of anchor ``k`` over each wall or none, and their derivatives.

    These are the variables (C, 9) that they depend on, the derivatives by these, and those (C,) by the
    squared height.
    """
    count, a = len(wall), FIRST_ANCHOR + PER_ANCHOR * k
    scale = 1.0 + mean[a + 4]
    length, by_height = np.empty(count), np.empty(count)
    index, slope = np.zeros((count, _PER_PATH), dtype=np.int64), np.zeros((count, _PER_PATH))
    source = np.zeros((layout.anchors, 1 + layout.slots, 2))
    source[k, 0, 0], source[k, 0, 1] = mean[a], mean[a + 1]
    for c in range(count):
        f = 1 + wall[c]
        if f > 0:
            v = FIRST_ANCHOR + PER_ANCHOR * layout.anchors + 2 * wall[c]
            source[k, f, 0], source[k, f, 1] = mirror(mean[a], mean[a + 1], mean[v], mean[v + 1])
        dx, dy = mean[0] - source[k, f, 0], mean[1] - source[k, f, 1]
        slanted = scale * np.sqrt(max(dx * dx + dy * dy + mean[a + 2], 1e-6))
        length[c], by_height[c] = slanted + mean[a + 3], 0.5 * scale * scale / slanted
        length_gradient(layout, mean, source, k, f, slanted, index[c], slope[c])
    return length, index, slope, by_height


@compiled
def _added_variance(k: int, covariance: Array, places: PlacePaths, s: int) -> float:
    """What place ``s`` adds to the variance of the squared height, which depends on nothing else yet."""
    w, variance = FIRST_ANCHOR + PER_ANCHOR * k + 2, places.height2_variance_m4[s]
    return variance - covariance[w, w] if variance >= 0.0 else 0.0


@compiled
def _spread(covariance: Array, index: Index, slope: Array, by_height: Array, added: float) -> Array:
    """Covariance (C, C) of path lengths, ``added`` being the variance that the squared height has more."""
    count = len(index)
    spread = np.empty((count, count))
    for c in range(count):
        for d in range(c + 1):
            total = by_height[c] * by_height[d] * added
            for i in range(_PER_PATH):
                row = 0.0
                for j in range(_PER_PATH):
                    row += covariance[index[c, i], index[d, j]] * slope[d, j]
                total += slope[c, i] * row
            spread[c, d] = spread[d, c] = total
    return spread


@compiled
def _root(spread: Array, places: PlacePaths, v: int, known: Index, root: Array) -> int:
    """Cholesky factor of the innovations of labelling ``v``; how many features it labels, and which."""
    m = 0
    for c in range(len(spread)):
        if places.label[v, c] >= 0:
            known[m] = c
            m += 1
    for i in range(m):
        for j in range(i + 1):
            total = spread[known[i], known[j]]
            if i == j:
                total += places.variance_m2[places.label[v, known[i]]]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = np.sqrt(total) if i == j else total / root[j, j]
    return m


@compiled
def _log_density(
    length: Array, places: PlacePaths, v: int, known: Index, m: int, root: Array, white: Array
) -> float:
    """Log density of the paths of labelling ``v`` over clutter's; whitened innovations go to ``white``."""
    total = 0.0
    for i in range(m):
        j = places.label[v, known[i]]
        residual = places.length_m[j] - length[known[i]]
        for k in range(i):
            residual -= root[i, k] * white[k]
        white[i] = residual / root[i, i]
        total -= (
            0.5 * white[i] * white[i] + np.log(root[i, i]) + 0.5 * _LOG_2PI + np.log(places.clutter_density)
        )
    return total


@compiled
def weigh_labellings(
    layout: Layout,
    k: int,
    log_weight: Array,
    mean: Array,
    covariance: Array,
    places: PlacePaths,
    order: Index,
    best: float,
    limits: BranchLimits,
    density: Array,
) -> None:
    """Log weights of the children of hypotheses, labelling by labelling.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    k : int
        The anchor.
    log_weight, mean, covariance : ndarray, shapes (R,), (R, n), (R, n, n)
        Hypotheses.
    places : PlacePaths
        Places, paths and labellings.
    order : ndarray of int64, shape (R * S,)
        Number ``r * S + s`` of each hypothesis and place, the likeliest first.
    best : float
        Log weight of the likeliest hypothesis of all.
    limits : BranchLimits
        Bounds.
    density : ndarray, shape (R, V)
        Filled with log weights; unchanged where a bound is met. The labellings of a place share its weight.
    """
    spots, count = len(places.place_m), len(places.wall)
    known, root, white = np.empty(count, dtype=np.int64), np.zeros((count, count)), np.empty(count)
    weighed = 0
    for i in range(len(order)):
        r, s = order[i] // spots, order[i] % spots
        begin, end = places.begin[s], places.begin[s + 1]
        bound = log_weight[r] + places.log_evidence[s]
        if bound <= best - limits.prune_nats or (i > 0 and weighed + end - begin > limits.max_labelled):
            break
        weighed += end - begin
        moved = _moved(layout, k, mean[r], covariance[r], places, s)
        length, index, slope, by_height = _path_lengths(layout, k, moved, places.wall)
        added = _added_variance(k, covariance[r], places, s)
        spread = _spread(covariance[r], index, slope, by_height, added)
        largest, total = -np.inf, 0.0
        for v in range(begin, end):
            m = _root(spread, places, v, known, root)
            density[r, v] = _log_density(length, places, v, known, m, root, white)
            largest = max(largest, density[r, v])
        for v in range(begin, end):
            total += np.exp(density[r, v] - largest)
        for v in range(begin, end):
            density[r, v] += bound - largest - np.log(total)
            best = max(best, density[r, v])


@compiled
def updated(
    layout: Layout, k: int, mean: Array, covariance: Array, places: PlacePaths, row: Index, child: Index
) -> tuple[Array, Array]:
    """Means (N, n) and covariances of hypotheses ``row`` after the paths of labellings ``child``."""
    size, count = mean.shape[1], len(places.wall)
    new_mean, new_covariance = np.empty((len(row), size)), np.empty((len(row), size, size))
    known, root, white = np.empty(count, dtype=np.int64), np.zeros((count, count)), np.empty(count)
    gain = np.empty((count, size))
    for n in range(len(row)):
        old, new, v = covariance[row[n]], new_covariance[n], child[n]
        s = places.candidate[v]
        moved = _moved(layout, k, mean[row[n]], old, places, s)
        length, index, slope, by_height = _path_lengths(layout, k, moved, places.wall)
        added, w = _added_variance(k, old, places, s), FIRST_ANCHOR + PER_ANCHOR * k + 2
        m = _root(_spread(old, index, slope, by_height, added), places, v, known, root)
        _log_density(length, places, v, known, m, root, white)
        for i in range(m):
            gain[i] = 0.0
            for t in range(_PER_PATH):
                factor = slope[known[i], t]
                for b in range(size):
                    gain[i, b] += factor * old[index[known[i], t], b]
            gain[i, w] += by_height[known[i]] * added
            for j in range(i):
                for b in range(size):
                    gain[i, b] -= root[i, j] * gain[j, b]
            for b in range(size):
                gain[i, b] /= root[i, i]
                moved[b] += gain[i, b] * white[i]
        new_mean[n] = moved
        for a in range(size):
            for b in range(a + 1):
                new[a, b] = old[a, b]
            if a == w:
                new[a, a] += added
            for i in range(m):
                factor = gain[i, a]
                for b in range(a + 1):
                    new[a, b] -= factor * gain[i, b]
            for b in range(a):
                new[b, a] = new[a, b]
    return new_mean, new_covariance
