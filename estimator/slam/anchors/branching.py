"""Hypotheses that have located an anchor: one of each old one, place and labelling of the present paths.

Neither the candidates' covariances are believed nor their labels: both come from walls held fixed. The
anchor starts wide, and the present paths enter the joint Gaussian, where anchor and walls become correlated,
once for each labelling. Earlier epochs only chose the place; their lengths are not used as information
again.

At most ``max_labelled`` triples are weighed, the likeliest hypotheses and places first, and at most
``max_branches`` of the best become hypotheses: the rest would not survive the mixture reduction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

if TYPE_CHECKING:
    from estimator.slam.gaussian.state import Rows as Hypotheses
    from estimator.slam.layout import Layout

__all__ = ["BranchLimits", "PlacePaths", "branch_hypotheses"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_LOG_2PI = float(np.log(2.0 * np.pi))
_PER_PATH = 8  # state variables that a path over one bounce depends on


class PlacePaths(NamedTuple):
    """Places of an anchor and the paths that it may be heard over.

    Parameters
    ----------
    place_m : ndarray, shape (S, 2)
        Places.
    bias_m : ndarray, shape (S,)
        Clock bias at each.
    log_evidence : ndarray, shape (S,)
        Log weight that each brings.
    candidate : ndarray of int64, shape (V,)
        The place of each labelling, ascending.
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
    log_evidence: Array
    candidate: Index
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


class _Where(NamedTuple):
    """Positions in the state vector: the anchor's x, y, w, b, all clocks' b, and the first wall."""

    anchor: int
    clocks: Index
    walls: int


def branch_hypotheses(
    hypotheses: Hypotheses,
    members: Index,
    layout: Layout,
    anchor: int,
    places: PlacePaths,
    anchor_std_m: float,
    height2: tuple[float, float],
    fresh_visibility: Array,
    limits: BranchLimits,
) -> Hypotheses:
    """New hypotheses in which ``anchor`` is located.

    Parameters
    ----------
    hypotheses : Hypotheses
        All of the state: none is made that is ``prune_nats`` below the best of these.
    members : ndarray of int64
        Those that branch; all or none of them have located the anchor.
    layout : Layout
        Positions in the state vector.
    anchor : int
        The anchor.
    places : PlacePaths
        Where it may be.
    anchor_std_m : float
        Standard deviation per axis that it starts with, metres.
    height2 : tuple of float
        Mean and standard deviation of the squared height of an anchor that was located elsewhere, square
        metres.
    fresh_visibility : ndarray, shape (F,)
        Prior visibility of its features.
    limits : BranchLimits
        Bounds.

    Returns
    -------
    Hypotheses
        Possibly none.
    """
    base = hypotheses.take(members)
    xy, w = layout.anchor_xy(anchor), layout.height2(anchor)
    if base.located[:, anchor].any():  # what was known of the anchor goes with its place
        known = slice(xy.start, w + 1)
        base.covariance[:, known, :] = 0.0
        base.covariance[:, :, known] = 0.0
        base.mean[:, w], base.covariance[:, w, w] = height2[0], height2[1] ** 2
    base.covariance[:, xy, xy] = anchor_std_m**2 * np.eye(2)
    clocks = np.array([layout.bias(j) for j in range(layout.anchors)])
    where = _Where(xy.start, clocks, layout.walls.start)
    row, child, weight = _weigh(
        base.log_weight,
        base.mean,
        base.covariance,
        where,
        places,
        float(hypotheses.log_weight.max()),
        limits,
    )
    order = np.argsort(-weight, kind="stable")[: limits.max_branches]
    row, child, weight = row[order], child[order], weight[order]
    mean, covariance = _updated(base.mean, base.covariance, where, places, row, child)
    new = base.take(row)
    new.located[:, anchor] = True
    new.visibility[:, anchor] = fresh_visibility
    return replace(new, log_weight=weight, mean=mean, covariance=covariance)


@compiled
def _moved(mean: Array, covariance: Array, where: _Where, places: PlacePaths, s: int) -> Array:
    """A hypothesis's mean with the anchor at place ``s``; clocks that agree move together."""
    moved, b = mean.copy(), where.anchor + 3
    moved[where.anchor], moved[where.anchor + 1] = places.place_m[s, 0], places.place_m[s, 1]
    shift = places.bias_m[s] - mean[b]
    scale = max(covariance[b, b], 1e-12)
    for i in range(len(where.clocks)):
        other = where.clocks[i]
        moved[other] += shift if other == b else covariance[other, b] / scale * shift
    return moved


@compiled
def _path_lengths(mean: Array, where: _Where, wall: Index) -> tuple[Array, Index, Array]:
    """Lengths (C,) of paths over each wall or none, the variables (C, 8) they depend on, and derivatives."""
    count, a = len(wall), where.anchor
    length, index, slope = (
        np.empty(count),
        np.zeros((count, _PER_PATH), dtype=np.int64),
        np.zeros((count, _PER_PATH)),
    )
    x, y, ax, ay, height2 = mean[0], mean[1], mean[a], mean[a + 1], mean[a + 2]
    for c in range(count):
        index[c, 0], index[c, 1] = 0, 1
        for i in range(4):
            index[c, 2 + i] = a + i
        vx, vy, sx, sy, scale, size = 0.0, 0.0, ax, ay, 0.0, 1.0
        if wall[c] >= 0:
            v = where.walls + 2 * wall[c]
            index[c, 6], index[c, 7] = v, v + 1
            vx, vy = mean[v], mean[v + 1]
            size = vx * vx + vy * vy
            scale = (ax * vx + ay * vy) / size
            sx, sy = ax + (1.0 - 2.0 * scale) * vx, ay + (1.0 - 2.0 * scale) * vy
        dx, dy = x - sx, y - sy
        flat = np.sqrt(max(dx * dx + dy * dy + height2, 1e-6))
        ux, uy = dx / flat, dy / flat
        along = ux * vx + uy * vy
        length[c] = flat + mean[a + 3]
        slope[c, 0], slope[c, 1] = ux, uy
        slope[c, 2] = -(ux - 2.0 * along / size * vx)
        slope[c, 3] = -(uy - 2.0 * along / size * vy)
        slope[c, 4], slope[c, 5] = 0.5 / flat, 1.0
        if wall[c] >= 0:
            slope[c, 6] = 2.0 * along * (ax - 2.0 * scale * vx) / size - (1.0 - 2.0 * scale) * ux
            slope[c, 7] = 2.0 * along * (ay - 2.0 * scale * vy) / size - (1.0 - 2.0 * scale) * uy
    return length, index, slope


@compiled
def _spread(covariance: Array, index: Index, slope: Array) -> Array:
    """Covariance (C, C) of path lengths."""
    count = len(index)
    spread = np.empty((count, count))
    for c in range(count):
        for d in range(c + 1):
            total = 0.0
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
def _weigh(
    log_weight: Array,
    mean: Array,
    covariance: Array,
    where: _Where,
    places: PlacePaths,
    best: float,
    limits: BranchLimits,
) -> tuple[Index, Index, Array]:
    """Hypothesis, labelling and log weight of all children within ``prune_nats`` of the best."""
    rows, spots, count = len(log_weight), len(places.place_m), len(places.wall)
    begin = np.searchsorted(places.candidate, np.arange(spots + 1))
    bound = np.empty(rows * spots)  # the labellings of a place share its weight
    for r in range(rows):
        for s in range(spots):
            bound[r * spots + s] = log_weight[r] + places.log_evidence[s]
    order = np.argsort(-bound, kind="mergesort")
    row, child, weight = [0], [0], [0.0]
    known, root, white = np.empty(count, dtype=np.int64), np.zeros((count, count)), np.empty(count)
    weighed = 0
    for i in range(len(order)):
        r, s = order[i] // spots, order[i] % spots
        own = begin[s + 1] - begin[s]
        if bound[order[i]] <= best - limits.prune_nats or weighed + own > limits.max_labelled:
            break
        weighed += own
        moved = _moved(mean[r], covariance[r], where, places, s)
        length, index, slope = _path_lengths(moved, where, places.wall)
        spread = _spread(covariance[r], index, slope)
        density = np.empty(own)
        for v in range(own):
            m = _root(spread, places, begin[s] + v, known, root)
            density[v] = _log_density(length, places, begin[s] + v, known, m, root, white)
        largest = density.max()
        density -= largest + np.log(np.exp(density - largest).sum())
        for v in range(own):
            total = bound[order[i]] + density[v]
            best = max(best, total)
            if total > best - limits.prune_nats:
                row.append(r)
                child.append(begin[s] + v)
                weight.append(total)
    weights = np.array(weight[1:])
    kept = weights > best - limits.prune_nats
    return np.array(row[1:])[kept], np.array(child[1:])[kept], weights[kept]


@compiled
def _updated(
    mean: Array, covariance: Array, where: _Where, places: PlacePaths, row: Index, child: Index
) -> tuple[Array, Array]:
    """Means (N, n) and covariances of hypotheses ``row`` after the paths of labellings ``child``."""
    size, count = mean.shape[1], len(places.wall)
    new_mean, new_covariance = np.empty((len(row), size)), np.empty((len(row), size, size))
    known, root, white = np.empty(count, dtype=np.int64), np.zeros((count, count)), np.empty(count)
    gain = np.empty((count, size))
    for n in range(len(row)):
        old, new, v = covariance[row[n]], new_covariance[n], child[n]
        moved = _moved(mean[row[n]], old, where, places, places.candidate[v])
        length, index, slope = _path_lengths(moved, where, places.wall)
        m = _root(_spread(old, index, slope), places, v, known, root)
        _log_density(length, places, v, known, m, root, white)
        for i in range(m):
            gain[i] = 0.0
            for t in range(_PER_PATH):
                factor = slope[known[i], t]
                for b in range(size):
                    gain[i, b] += factor * old[index[known[i], t], b]
            for k in range(i):
                for b in range(size):
                    gain[i, b] -= root[i, k] * gain[k, b]
            for b in range(size):
                gain[i, b] /= root[i, i]
                moved[b] += gain[i, b] * white[i]
        new_mean[n] = moved
        for a in range(size):
            for b in range(a + 1):
                new[a, b] = old[a, b]
            for i in range(m):
                factor = gain[i, a]
                for b in range(a + 1):
                    new[a, b] -= factor * gain[i, b]
            for b in range(a):
                new[b, a] = new[a, b]
    return new_mean, new_covariance
