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
from estimator.slam.models.features import mirror

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
    by_agent : ndarray, shape (Q, 2, 2)
        Their derivatives by the agent's position: turns and mirrors.
    reach_m : ndarray, shape (E, Q)
        From the expected length of a path, whatever its direction, that one may be: metres.
    walls : int
        L: the first 1 + L centres are of up to one bounce.
    """

    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array
    by_agent: Array
    reach_m: Array
    walls: int


@compiled
def image_circles(
    position: Array,
    covariance: Array,
    widest: Array,
    vrp: Array,
    vrp_covariance: Array,
    pairs: Index,
    gate_sigma: float,
) -> Circles:
    """The circles of some epochs.

    Parameters
    ----------
    position : ndarray, shape (E, 2)
        Agent, gauge frame, metres.
    covariance : ndarray, shape (E, 2, 2)
        Its covariance, square metres.
    widest : ndarray, shape (E,)
        Largest variance of the lengths of each epoch's paths, square metres.
    vrp, vrp_covariance : ndarray, shapes (L, 2), (L, 2, 2)
        Walls.
    pairs : ndarray of int64, shape (P, 2)
        Pairs of walls, as :func:`met_wall_pairs` gives them.
    gate_sigma : float
        Standard deviations that a path may be off.
    """
    epochs, walls = len(position), len(vrp)
    count = 1 + walls + len(pairs)
    x, y = np.empty((epochs, count)), np.empty((epochs, count))
    xx, xy, yy = np.empty((epochs, count)), np.empty((epochs, count)), np.empty((epochs, count))
    by_agent, own = np.zeros((count, 2, 2)), np.zeros((count, 2, 2))
    by_agent[0] = np.eye(2)
    for w in range(walls):
        square = vrp[w, 0] ** 2 + vrp[w, 1] ** 2
        by_agent[1 + w] = np.eye(2) - 2.0 / square * np.outer(vrp[w], vrp[w])
        own[1 + w] = vrp_covariance[w]
    for p in range(len(pairs)):
        near, far, q = pairs[p, 0], pairs[p, 1], 1 + walls + p
        by_agent[q] = by_agent[1 + near] @ by_agent[1 + far]
        own[q] = vrp_covariance[near] + vrp_covariance[far]
    for e in range(epochs):
        x[e, 0], y[e, 0] = position[e, 0], position[e, 1]
        for w in range(walls):
            x[e, 1 + w], y[e, 1 + w] = mirror(position[e, 0], position[e, 1], vrp[w, 0], vrp[w, 1])
        for p in range(len(pairs)):
            near, far, q = pairs[p, 0], pairs[p, 1], 1 + walls + p
            x[e, q], y[e, q] = mirror(x[e, 1 + far], y[e, 1 + far], vrp[near, 0], vrp[near, 1])
        for q in range(count):
            (a, b), (c, d) = by_agent[q]
            pxx, pxy, pyy = covariance[e, 0, 0], covariance[e, 0, 1], covariance[e, 1, 1]
            xx[e, q] = a * a * pxx + 2.0 * a * b * pxy + b * b * pyy + own[q, 0, 0]
            xy[e, q] = a * c * pxx + (a * d + b * c) * pxy + b * d * pyy + own[q, 0, 1]
            yy[e, q] = c * c * pxx + 2.0 * c * d * pxy + d * d * pyy + own[q, 1, 1]
    reach = np.empty((epochs, count))
    for e in range(epochs):
        for q in range(count):
            across = np.sqrt(0.25 * (xx[e, q] - yy[e, q]) ** 2 + xy[e, q] ** 2)
            largest = 0.5 * (xx[e, q] + yy[e, q]) + across
            reach[e, q] = gate_sigma * np.sqrt(max(largest, 0.0) + widest[e]) * (1.0 + 1e-9) + 1e-9
    return Circles(x, y, xx, xy, yy, by_agent, reach, walls)


def met_wall_pairs(position: Array, vrp: Array, margin: float, limit: int) -> Index:
    """Ordered pairs (P, 2) of walls over which a path can come to one of the positions (E, 2).

    From the anchor over the near wall, then the far one. All pairs, or the likeliest ``limit``: first those
    that a path on the agent's side of the near wall meets, where the agent's image in the far wall stands on
    this side too, give or take ``margin`` metres; and of these the ones of the shortest paths: none is
    shorter than the way from that image to the near wall.
    """
    near, far = np.nonzero(~np.eye(len(vrp), dtype=bool))
    if near.size > limit:
        size = np.hypot(vrp[:, 0], vrp[:, 1])
        normal = vrp / size[:, None]
        side = position @ normal.T - 0.5 * size  # (E, L)
        image = side[:, :, None] - 2.0 * (normal @ normal.T) * side[:, None, :]  # (E, near, far)
        towards = np.where(side[:, :, None] > 0.0, image, -image).max(axis=0)[near, far]
        chosen = np.sort(np.lexsort((np.abs(towards), towards < -margin))[:limit])
        near, far = near[chosen], far[chosen]
    return np.stack([near, far], axis=1)


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
