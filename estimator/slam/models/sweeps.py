"""Beam sweeps: the agent's own mirror images in the walls, relative to the agent.

A flash gives ``M_v(p) - p`` in the agent's axes: distance and bearing of a wall, the distance too long by the
echo bias of all sweeps. With the heading held it
tells the rotation of the map again; with the heading unknown one angle per sweep is integrated out, and the
distances to the walls and the angles between them remain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.measurements import GaussianVrp
from estimator.slam.models.state_vector import ECHO_BIAS, FIRST_ANCHOR, PER_ANCHOR, THETA, Layout

__all__ = ["FLASH_ENTRIES", "flash_of", "own_covariance", "predict_flashes"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
FLASH_ENTRIES = 6  # states that a flash depends on
_LEAST_SHARE = 1e-4  # numerical floor of the share of a variance that is a flash's own


def own_covariance(flash: GaussianVrp, echo_bias_std_m: float) -> Array:
    """Covariance (2, 2) of a flash without the error in range that all share, square metres."""
    size = float(np.linalg.norm(flash.mean_m))
    if echo_bias_std_m == 0.0 or size == 0.0:
        return flash.covariance_m2
    along = flash.mean_m / size
    most = (1.0 - _LEAST_SHARE) / float(along @ np.linalg.solve(flash.covariance_m2, along))
    return np.asarray(flash.covariance_m2 - min(4.0 * echo_bias_std_m**2, most) * np.outer(along, along))


@compiled
def flash_of(layout: Layout, mean: Array, slot: int, index: Index, value: Array) -> tuple[float, float]:
    """The flash of a wall, turned by ``theta`` into the expected gauge frame's axes, metres.

    ``index`` (6,) and ``value`` (2, 6) take the derivatives of its coordinates: by agent, wall, theta and
    echo bias.
    """
    w = FIRST_ANCHOR + PER_ANCHOR * layout.anchors + 2 * slot
    px, py, vx, vy = mean[0], mean[1], mean[w], mean[w + 1]
    square = vx * vx + vy * vy
    scale = (vx * px + vy * py) / square
    c, s = np.cos(mean[THETA]), np.sin(mean[THETA])
    ux, uy = (1.0 - 2.0 * scale) * vx, (1.0 - 2.0 * scale) * vy
    x, y = c * ux - s * uy, s * ux + c * uy
    index[0], index[1], index[2], index[3], index[4], index[5] = 0, 1, w, w + 1, THETA, ECHO_BIAS
    rx, ry = px - 2.0 * scale * vx, py - 2.0 * scale * vy
    columns = np.empty((2, 4))
    columns[0, 0], columns[1, 0] = -2.0 / square * vx * vx, -2.0 / square * vy * vx
    columns[0, 1], columns[1, 1] = -2.0 / square * vx * vy, -2.0 / square * vy * vy
    columns[0, 2], columns[1, 2] = 1.0 - 2.0 * scale - 2.0 / square * vx * rx, -2.0 / square * vy * rx
    columns[0, 3], columns[1, 3] = -2.0 / square * vx * ry, 1.0 - 2.0 * scale - 2.0 / square * vy * ry
    for i in range(4):
        value[0, i] = c * columns[0, i] - s * columns[1, i]
        value[1, i] = s * columns[0, i] + c * columns[1, i]
    length = np.sqrt(x * x + y * y) + 1e-12
    nx, ny, bias = x / length, y / length, 2.0 * mean[ECHO_BIAS] / length
    for i in range(4):
        along = bias * (nx * value[0, i] + ny * value[1, i])
        value[0, i] += bias * value[0, i] - along * nx
        value[1, i] += bias * value[1, i] - along * ny
    x, y = x * (1.0 + bias), y * (1.0 + bias)
    value[0, 4], value[1, 4] = -y, x
    value[0, 5], value[1, 5] = 2.0 * nx, 2.0 * ny
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
    index, value = np.empty(FLASH_ENTRIES, dtype=np.int64), np.empty((2, FLASH_ENTRIES))
    for slot in range(layout.slots):
        x, y = flash_of(layout, mean, slot, index, value)
        flash[slot, 0], flash[slot, 1] = x, y
        for i in range(FLASH_ENTRIES):
            jacobian[slot, 0, index[i]] = value[0, i]
            jacobian[slot, 1, index[i]] = value[1, i]
    return flash, jacobian
