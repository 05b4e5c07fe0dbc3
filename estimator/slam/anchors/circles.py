"""Where an anchor can be, given one path length: circles round the agent and round its images.

A mirror keeps lengths, so the path that leaves the anchor and bounces off wall ``l`` is as long as the
straight way from the anchor to the *agent's* image in ``l``, and one over two walls as long as the way to
the image of an image. At most ``1 + L + max_wall_pairs`` circles a path and epoch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["Circles", "image_circles", "intersect", "met_wall_pairs"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Circles(NamedTuple):
    """Centres of circles at E epochs: the agent, its images in L walls, its images in P pairs of walls.

    Parameters
    ----------
    x, y : ndarray, shape (E, Q)
        Centres, Q = 1 + L + P, metres.
    xx, xy, yy : ndarray, shape (E, Q)
        Their covariances, square metres.
    walls : int
        L: the first 1 + L centres are of up to one bounce.
    """

    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array
    walls: int


@compiled
def _mirrored(x: float, y: float, vx: float, vy: float) -> tuple[float, float]:
    """Image of a point in the wall of a VRP, RP at the origin (equation (2))."""
    scale = 1.0 - 2.0 * (x * vx + y * vy) / (vx * vx + vy * vy)
    return x + scale * vx, y + scale * vy


@compiled
def image_circles(
    position: Array, variance: Array, vrp: Array, vrp_covariance: Array, pairs: Index
) -> Circles:
    """The circles of some epochs.

    Parameters
    ----------
    position : ndarray, shape (E, 2)
        Agent, gauge frame, metres.
    variance : ndarray, shape (E,)
        Its variance per axis, square metres.
    vrp, vrp_covariance : ndarray, shapes (L, 2), (L, 2, 2)
        Walls.
    pairs : ndarray of int64, shape (P, 2)
        Pairs of walls, as :func:`met_wall_pairs` gives them.
    """
    epochs, walls = len(position), len(vrp)
    count = 1 + walls + len(pairs)
    x, y = np.empty((epochs, count)), np.empty((epochs, count))
    xx, xy, yy = np.empty((epochs, count)), np.empty((epochs, count)), np.empty((epochs, count))
    for e in range(epochs):
        x[e, 0], y[e, 0] = position[e, 0], position[e, 1]
        xx[e, 0], xy[e, 0], yy[e, 0] = variance[e], 0.0, variance[e]
        for w in range(walls):
            x[e, 1 + w], y[e, 1 + w] = _mirrored(position[e, 0], position[e, 1], vrp[w, 0], vrp[w, 1])
            xx[e, 1 + w] = variance[e] + vrp_covariance[w, 0, 0]
            xy[e, 1 + w] = vrp_covariance[w, 0, 1]
            yy[e, 1 + w] = variance[e] + vrp_covariance[w, 1, 1]
        for p in range(len(pairs)):
            near, far, q = pairs[p, 0], pairs[p, 1], 1 + walls + p
            x[e, q], y[e, q] = _mirrored(x[e, 1 + far], y[e, 1 + far], vrp[near, 0], vrp[near, 1])
            xx[e, q] = xx[e, 1 + near] + vrp_covariance[far, 0, 0]
            xy[e, q] = xy[e, 1 + near] + vrp_covariance[far, 0, 1]
            yy[e, q] = yy[e, 1 + near] + vrp_covariance[far, 1, 1]
    return Circles(x, y, xx, xy, yy, walls)


@compiled
def met_wall_pairs(position: Array, vrp: Array, margin: float, limit: int) -> Index:
    """Ordered pairs (P, 2) of walls over which a path can come from anywhere to one of the positions (E, 2).

    From the anchor over the near wall, then the far one: the agent's image in the far wall has to stand on
    the agent's side of the near one, give or take ``margin`` metres, or the ray would leave the far wall
    away from the near one. If there are more than ``limit``, those whose paths can be the shortest: none is
    shorter than the way from that image to the near wall.
    """
    walls, epochs = len(vrp), len(position)
    pairs = np.empty((walls * walls, 2), dtype=np.int64)
    least = np.empty(walls * walls)
    count = 0
    for near in range(walls):
        size = np.sqrt(vrp[near, 0] ** 2 + vrp[near, 1] ** 2)
        for far in range(walls):
            if far == near:
                continue
            best = np.inf
            for e in range(epochs):
                x, y = position[e, 0], position[e, 1]
                side = (x * vrp[near, 0] + y * vrp[near, 1]) / size - 0.5 * size
                ix, iy = _mirrored(x, y, vrp[far, 0], vrp[far, 1])
                image = (ix * vrp[near, 0] + iy * vrp[near, 1]) / size - 0.5 * size
                towards = image if side > 0.0 else -image
                if towards > -margin:
                    best = min(best, max(towards, 0.0))
            if best < np.inf:
                pairs[count, 0], pairs[count, 1], least[count] = near, far, best
                count += 1
    pairs, least = pairs[:count], least[:count]
    if count > limit:
        chosen = np.sort(np.argsort(least, kind="mergesort")[:limit])
        return pairs[chosen]
    return pairs.copy()


@compiled
def intersect(
    ax: float, ay: float, ar: float, bx: float, by: float, br: float, touch: float
) -> tuple[float, float, float, float]:
    """The two points where circles of centres (ax, ay), (bx, by) and radii ar, br meet; NaN if apart.

    Circles that miss each other touch, if the squared height of the triangle is more than ``-touch``, m^2.
    """
    dx, dy = bx - ax, by - ay
    distance = np.sqrt(dx * dx + dy * dy)
    if not distance > 1e-6:
        return np.nan, np.nan, np.nan, np.nan
    along = (distance * distance + ar * ar - br * br) / (2.0 * distance)
    height2 = ar * ar - along * along
    if not height2 > -touch:
        return np.nan, np.nan, np.nan, np.nan
    height = np.sqrt(max(height2, 0.0))
    ux, uy = dx / distance, dy / distance
    fx, fy = ax + along * ux, ay + along * uy
    return fx - uy * height, fy + ux * height, fx + uy * height, fy - ux * height
