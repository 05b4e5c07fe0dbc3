"""Beam sweeps: the agent's own mirror images in the walls, relative to the agent.

A flash gives ``M_v(p) - p`` in the agent's axes: distance and bearing of a wall. With the heading held it
tells the rotation of the map again; with the heading unknown one angle per sweep is integrated out, and the
distances to the walls and the angles between them remain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, THETA, Layout

__all__ = ["flash_of", "predict_flashes"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def flash_of(layout: Layout, mean: Array, slot: int, index: Index, value: Array) -> tuple[float, float]:
    """The flash of a wall, turned by ``theta`` into the expected gauge frame's axes, metres.

    ``index`` (5,) and ``value`` (2, 5) take the derivatives of its coordinates: by agent, wall and theta.
    """
    w = FIRST_ANCHOR + PER_ANCHOR * layout.anchors + 2 * slot
    px, py, vx, vy = mean[0], mean[1], mean[w], mean[w + 1]
    square = vx * vx + vy * vy
    scale = (vx * px + vy * py) / square
    c, s = np.cos(mean[THETA]), np.sin(mean[THETA])
    ux, uy = (1.0 - 2.0 * scale) * vx, (1.0 - 2.0 * scale) * vy
    x, y = c * ux - s * uy, s * ux + c * uy
    index[0], index[1], index[2], index[3], index[4] = 0, 1, w, w + 1, THETA
    rx, ry = px - 2.0 * scale * vx, py - 2.0 * scale * vy
    columns = np.empty((2, 4))
    columns[0, 0], columns[1, 0] = -2.0 / square * vx * vx, -2.0 / square * vy * vx
    columns[0, 1], columns[1, 1] = -2.0 / square * vx * vy, -2.0 / square * vy * vy
    columns[0, 2], columns[1, 2] = 1.0 - 2.0 * scale - 2.0 / square * vx * rx, -2.0 / square * vy * rx
    columns[0, 3], columns[1, 3] = -2.0 / square * vx * ry, 1.0 - 2.0 * scale - 2.0 / square * vy * ry
    for i in range(4):
        value[0, i] = c * columns[0, i] - s * columns[1, i]
        value[1, i] = s * columns[0, i] + c * columns[1, i]
    value[0, 4], value[1, 4] = -y, x
    return x, y


@compiled
def predict_flashes(mean: Array, layout: Layout) -> tuple[Array, Array]:
    """The agent's mirror image in every wall, relative to the agent.

    Parameters
    ----------
    mean : ndarray, shape (n,)
        A state vector.
    layout : Layout
        Positions in it.

    Returns
    -------
    flash : ndarray, shape (L, 2)
        Turned by ``theta``, so that the axes are the expected gauge frame's.
    jacobian : ndarray, shape (L, 2, n)
        Derivatives by the state vector.
    """
    flash, jacobian = np.empty((layout.slots, 2)), np.zeros((layout.slots, 2, mean.size))
    index, value = np.empty(5, dtype=np.int64), np.empty((2, 5))
    for slot in range(layout.slots):
        x, y = flash_of(layout, mean, slot, index, value)
        flash[slot, 0], flash[slot, 1] = x, y
        for i in range(5):
            jacobian[slot, 0, index[i]] = value[0, i]
            jacobian[slot, 1, index[i]] = value[1, i]
    return flash, jacobian
