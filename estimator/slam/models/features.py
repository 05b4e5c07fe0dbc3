"""Features: where the source of a path stands, and how it moves with the state.

Per anchor (PA) at ``a`` the features are the line of sight, a bounce off each wall
``l`` (the virtual anchor, (2), (11), (12)) and the double bounces off each ordered
pair ``(l, m)``, from the anchor over ``l`` then ``m`` to the agent (the image of an
image). With ``s = q.v / |v|^2`` a mirror is ``M_v(q) = q + (1 - 2 s) v``, because RP is the origin
and the wall stands half-way to its VRP ``v``. Where features are virtual anchors, each anchor has its
own points instead, and no pairs.

Features are numbered: line of sight 0, walls or virtual anchors ``1 + l``, pairs ``1 + L + l * L + m``.
These functions are the one place that knows which of the two a slot holds.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.geometry import mirror_xy
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = [
    "MOST_ENTRIES",
    "active_features",
    "gradient",
    "mirror",
    "possible_paths",
    "side_of_wall",
    "sources",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
mirror = compiled(mirror_xy)  # the image of a point in the wall with VRP v, RP at the origin
MOST_ENTRIES: Final = 11  # of the state vector that one path depends on: agent 2, anchor 5, walls 4


@compiled
def side_of_wall(qx: float, qy: float, vx: float, vy: float) -> float:
    """Signed distance of a point from a wall, negative on RP's side, metres."""
    size = np.sqrt(vx * vx + vy * vy)
    return float((qx * vx + qy * vy) / size - 0.5 * size)


@compiled
def active_features(
    layout: Layout, located: Mask, present: Mask, confirmed: Mask, owner: NDArray[np.int64]
) -> Mask:
    """Features (K, F) that a hypothesis has.

    Pairs need two walls that count as found; a virtual anchor is its owner's alone.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    located : ndarray of bool, shape (K,)
        Anchors that have been located.
    present : ndarray of bool, shape (L,)
        Slots that the hypothesis has.
    confirmed : ndarray of bool, shape (L,)
        Slots that count as found.
    owner : ndarray of int64, shape (L,)
        The anchor of each virtual anchor.
    """
    anchors, slots = layout.anchors, layout.slots
    pairs = slots * slots if layout.shared else 0
    active = np.zeros((anchors, 1 + slots + pairs), dtype=np.bool_)
    for k in range(anchors):
        if not located[k]:
            continue
        active[k, 0] = True
        for i in range(slots):
            active[k, 1 + i] = present[i] and (layout.shared or owner[i] == k)
        if layout.shared:
            for i in range(slots):
                if present[i] and confirmed[i]:
                    for j in range(slots):
                        if present[j] and confirmed[j]:
                            active[k, 1 + slots + i * slots + j] = i != j
    return active


@compiled
def sources(layout: Layout, mean: Array, active: Mask) -> Array:
    """Where the paths of the ``active`` features (K, F) seem to come from: (K, F, 2), metres.

    That is the anchor, its images and images of images, or its virtual anchors.
    """
    anchors, slots = layout.anchors, layout.slots
    first_slot = FIRST_ANCHOR + PER_ANCHOR * anchors
    source = np.zeros((anchors, active.shape[1], 2))
    for k in range(anchors):
        ax, ay = mean[FIRST_ANCHOR + PER_ANCHOR * k], mean[FIRST_ANCHOR + PER_ANCHOR * k + 1]
        source[k, 0, 0], source[k, 0, 1] = ax, ay
        if not layout.shared:
            for i in range(slots):
                w = first_slot + 4 * i
                source[k, 1 + i, 0] = mean[w + 2] + mean[w] * np.cos(mean[w + 1])
                source[k, 1 + i, 1] = mean[w + 3] + mean[w] * np.sin(mean[w + 1])
            continue
        for i in range(slots):
            if not active[k, 1 + i]:
                continue
            w = first_slot + 2 * i
            ix, iy = mirror(ax, ay, mean[w], mean[w + 1])
            source[k, 1 + i, 0], source[k, 1 + i, 1] = ix, iy
            for j in range(slots):
                f = 1 + slots + i * slots + j
                if active[k, f]:
                    v = first_slot + 2 * j
                    sx, sy = mirror(ix, iy, mean[v], mean[v + 1])
                    source[k, f, 0], source[k, f, 1] = sx, sy
    return source


@compiled
def possible_paths(layout: Layout, mean: Array, source: Array, active: Mask) -> Mask:
    """Which of the ``active`` features (K, F) geometry allows if walls had no ends.

    Agent and anchor must stand on the sides of the walls that the bounces need. Nothing forbids a virtual
    anchor.
    """
    possible = active.copy()
    if not layout.shared:
        return possible
    anchors, slots = layout.anchors, layout.slots
    first_slot = FIRST_ANCHOR + PER_ANCHOR * anchors
    agent = np.empty(slots)
    for i in range(slots):
        w = first_slot + 2 * i
        agent[i] = side_of_wall(mean[0], mean[1], mean[w], mean[w + 1])
    device = np.empty(slots)
    for k in range(anchors):
        for i in range(slots):
            w = first_slot + 2 * i
            device[i] = side_of_wall(source[k, 0, 0], source[k, 0, 1], mean[w], mean[w + 1])
            if active[k, 1 + i]:
                possible[k, 1 + i] = agent[i] * device[i] > 0.0
        for i in range(slots):
            wx, wy = mean[first_slot + 2 * i], mean[first_slot + 2 * i + 1]
            for j in range(slots):
                f = 1 + slots + i * slots + j
                if not active[k, f]:
                    continue
                v = first_slot + 2 * j
                image = side_of_wall(source[k, 1 + i, 0], source[k, 1 + i, 1], mean[v], mean[v + 1])
                if not agent[j] * image > 0.0:
                    possible[k, f] = False
                    continue
                fraction = agent[j] / (agent[j] + image)  # of the way back to the last wall
                double = side_of_wall(source[k, f, 0], source[k, f, 1], wx, wy)
                bounce = agent[i] + fraction * (double - agent[i])
                possible[k, f] = bounce * device[i] > 0.0
    return possible


@compiled
def _through_mirror(
    gx: float, gy: float, qx: float, qy: float, vx: float, vy: float
) -> tuple[float, float, float, float]:
    """A covector on a mirror image as covectors on the mirrored point and on the VRP."""
    square = vx * vx + vy * vy
    scale = (qx * vx + qy * vy) / square
    twice = 2.0 * (gx * vx + gy * vy) / square
    return (
        gx - twice * vx,
        gy - twice * vy,
        (1.0 - 2.0 * scale) * gx - twice * (qx - 2.0 * scale * vx),
        (1.0 - 2.0 * scale) * gy - twice * (qy - 2.0 * scale * vy),
    )


@compiled
def gradient(
    layout: Layout,
    mean: Array,
    source: Array,
    k: int,
    f: int,
    cx: float,
    cy: float,
    index: NDArray[np.int64],
    value: Array,
) -> int:
    """Derivatives by the state vector of what depends on agent minus source by the covector ``c``.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean : ndarray, shape (n,)
        The state vector.
    source : ndarray, shape (K, F, 2)
        From :func:`sources`.
    k, f : int
        Anchor and feature.
    cx, cy : float
        The covector.
    index, value : ndarray, shape (11,)
        Take the entries that are not zero: where they stand, and what they are.

    Returns
    -------
    int
        How many there are; three are left free for what depends on more than places.
    """
    anchors, slots = layout.anchors, layout.slots
    first_slot = FIRST_ANCHOR + PER_ANCHOR * anchors
    a = FIRST_ANCHOR + PER_ANCHOR * k
    index[0], index[1], value[0], value[1] = 0, 1, cx, cy
    count = 2
    gx, gy = -cx, -cy
    if f > 0 and not layout.shared:
        w = first_slot + 4 * (f - 1)
        cosine, sine = np.cos(mean[w + 1]), np.sin(mean[w + 1])
        for i in range(4):
            index[count + i] = w + i
        value[count] = gx * cosine + gy * sine
        value[count + 1] = mean[w] * (gy * cosine - gx * sine)
        value[count + 2], value[count + 3] = gx, gy
        return count + 4
    if f > slots:
        first, last = (f - 1 - slots) // slots, (f - 1 - slots) % slots
        w = first_slot + 2 * last
        gx, gy, bx, by = _through_mirror(
            gx, gy, source[k, 1 + first, 0], source[k, 1 + first, 1], mean[w], mean[w + 1]
        )
        index[count], index[count + 1], value[count], value[count + 1] = w, w + 1, bx, by
        count += 2
        f = 1 + first
    if f > 0:
        w = first_slot + 2 * (f - 1)
        gx, gy, bx, by = _through_mirror(gx, gy, mean[a], mean[a + 1], mean[w], mean[w + 1])
        index[count], index[count + 1], value[count], value[count + 1] = w, w + 1, bx, by
        count += 2
    index[count], index[count + 1], value[count], value[count + 1] = a, a + 1, gx, gy
    return count + 2
