"""Paths over two and three known walls, and the walls that they would be taken for.

A path over several walls is as long as a path over one wall that is not there: the image of an image
is the image of the anchor in *some* line. Where all the walls are known such paths are predicted, and must
start no wall. Often they come first: a double bounce is detected while one of its walls is still to be
found, and everything that this one path tells fits the wall that is not there. Once the other wall is
found the deception shows: wherever the wall was detected, and from every anchor that detected it,
a path over other walls is as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.features import mirror, side_of_wall

__all__ = ["explained_by_others", "path_over"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def path_over(agent: Array, device: Array, walls: Array, order: Index) -> float:
    """Length of the path from an anchor over walls to the agent; infinity where a bounce is impossible.

    Parameters
    ----------
    agent : ndarray, shape (2,)
        The agent, gauge frame, metres.
    device : ndarray, shape (4,)
        The anchor in the state vector: position, squared height difference, clock bias.
    walls : ndarray, shape (L, 2)
        VRPs.
    order : ndarray of int64, shape (B,)
        The walls, from the anchor on.
    """
    bounces = order.size
    image = np.empty((bounces + 1, 2))
    image[0, 0], image[0, 1] = device[0], device[1]
    for b in range(bounces):
        vx, vy = walls[order[b], 0], walls[order[b], 1]
        sx, sy = mirror(image[b, 0], image[b, 1], vx, vy)
        image[b + 1, 0], image[b + 1, 1] = sx, sy
    px, py = agent[0], agent[1]
    for b in range(bounces, 0, -1):  # from the agent back to the anchor
        vx, vy = walls[order[b - 1], 0], walls[order[b - 1], 1]
        here = side_of_wall(px, py, vx, vy)
        there = side_of_wall(image[b, 0], image[b, 1], vx, vy)
        if not here * there < 0.0:
            return np.inf
        fraction = here / (here - there)
        px, py = px + fraction * (image[b, 0] - px), py + fraction * (image[b, 1] - py)
    dx, dy = agent[0] - image[bounces, 0], agent[1] - image[bounces, 1]
    return float(np.sqrt(max(dx * dx + dy * dy + device[2], 1e-6)) + device[3])


@compiled
def explained_by_others(
    places: Array, device: Array, wall: Array, others: Array, radius_m: float, third: bool
) -> bool:
    """Whether paths over the same other walls are as long as that over ``wall`` at all places.

    In a right corner the order of the bounces changes along the way, and the length does not tell it.
    Time is that of all pairs, and of all triples if ``third``.

    Parameters
    ----------
    places : ndarray, shape (P, 2)
        Where the agent detected the anchor over the wall, gauge frame, metres.
    device : ndarray, shape (4,)
        The anchor in the state vector.
    wall : ndarray, shape (2,)
        The VRP in question.
    others : ndarray, shape (L, 2)
        VRPs of the other walls.
    radius_m : float
        Lengths this close are alike.
    third : bool
        Whether paths over three walls are looked at, too.
    """
    count = places.shape[0]
    own = np.empty(count)
    ix, iy = mirror(device[0], device[1], wall[0], wall[1])
    for p in range(count):
        dx, dy = places[p, 0] - ix, places[p, 1] - iy
        own[p] = np.sqrt(max(dx * dx + dy * dy + device[2], 1e-6)) + device[3]
    walls = others.shape[0]
    pair, triple = np.empty(2, dtype=np.int64), np.empty(3, dtype=np.int64)
    for a in range(walls):
        for b in range(a + 1, walls):
            every = True
            for p in range(count):
                pair[0], pair[1] = a, b
                near = abs(path_over(places[p], device, others, pair) - own[p]) < radius_m
                pair[0], pair[1] = b, a
                near = near or abs(path_over(places[p], device, others, pair) - own[p]) < radius_m
                every = every and near
            if every:
                return True
    if not third:
        return False
    orders = np.array([[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]])
    some = np.empty(3, dtype=np.int64)
    for a in range(walls):
        for b in range(walls):
            for c in range(b, walls):
                # the same walls in any order: a b a (c = b), or three different ones, each set once
                if a in (b, c) or (c > b and a > b):
                    continue
                some[0], some[1], some[2] = a, b, c
                every = True
                for p in range(count):
                    near = False
                    for i in range(orders.shape[0]):
                        if c == b:
                            triple[0], triple[1], triple[2] = a, b, a
                        else:
                            for j in range(3):
                                triple[j] = some[orders[i, j]]
                        if abs(path_over(places[p], device, others, triple) - own[p]) < radius_m:
                            near = True
                            break
                        if c == b:
                            break
                    every = every and near
                    if not every:
                        break
                if every:
                    return True
    return False
