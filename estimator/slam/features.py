"""Path lengths of features and their derivatives.

Per anchor (PA) at ``a`` the features are the line of sight, a bounce off each wall
``l`` (the virtual anchor, (2), (11), (12)) and the double bounces off each ordered
pair ``(l, m)``, from the anchor over ``l`` then ``m`` to the agent (the image of an
image). With ``n = v / |v|`` a mirror is ``M_v(q) = q + (1 - 2 s) v``, ``s = q.v / |v|^2``,
because RP is the origin and the wall stands half-way to its VRP ``v``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.layout import Layout

__all__ = ["Prediction", "predict_paths", "reflect", "wall_side"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Expected path lengths of all features of all anchors.

    Parameters
    ----------
    length_m : ndarray, shape (R, K, F)
        Path lengths; features ordered line of sight, walls, pairs ``1 + L + l * L + m``.
    jacobian : ndarray, shape (R, K, F, n)
        Derivatives by the state vector.
    possible : ndarray of bool, shape (R, K, F)
        Whether the bounces are geometrically possible if the walls were infinite.
    """

    length_m: Array
    jacobian: Array
    possible: NDArray[np.bool_]


def reflect(point: Array, vrp: Array) -> Array:
    """Mirror images, arrays (..., 2) that broadcast, RP at the origin (equation (2))."""
    scale = np.sum(point * vrp, axis=-1, keepdims=True) / np.sum(vrp * vrp, axis=-1, keepdims=True)
    return np.asarray(point + (1.0 - 2.0 * scale) * vrp)


def wall_side(point: Array, vrp: Array) -> Array:
    """Signed distance of points from walls, negative on RP's side; (..., 2) -> (...)."""
    length = np.sqrt(np.sum(vrp * vrp, axis=-1))
    return np.asarray(np.sum(point * vrp, axis=-1) / length - 0.5 * length)


def _by_wall(point: Array, vrp: Array, direction: Array) -> Array:
    """``direction^T d reflect(point, vrp) / d vrp``, arrays (..., 2) that broadcast."""
    square = np.sum(vrp * vrp, axis=-1, keepdims=True)
    scale = np.sum(point * vrp, axis=-1, keepdims=True) / square
    along = np.sum(vrp * direction, axis=-1, keepdims=True)
    return np.asarray((1.0 - 2.0 * scale) * direction - 2.0 * along / square * (point - 2.0 * scale * vrp))


def _flip(direction: Array, vrp: Array) -> Array:
    """``direction^T d reflect(point, vrp) / d point``: the mirrored direction."""
    square = np.sum(vrp * vrp, axis=-1, keepdims=True)
    along = np.sum(vrp * direction, axis=-1, keepdims=True)
    return np.asarray(direction - 2.0 * along / square * vrp)


def predict_paths(mean: Array, layout: Layout) -> Prediction:
    """Path lengths, derivatives and geometric possibility of every feature.

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors; empty wall slots and unknown anchors may hold any finite,
        non-zero numbers (their features are the caller's to mask).
    layout : Layout
        Positions in the state vector.

    Returns
    -------
    Prediction
    """
    rows, anchors, slots = len(mean), layout.anchors, layout.slots
    position = mean[:, None, 0:2]
    devices = mean[:, layout.FIRST_ANCHOR : layout.FIRST_ANCHOR + 3 * anchors].reshape(rows, anchors, 3)
    anchor, height2 = devices[:, :, 0:2], devices[:, :, 2]
    wall = mean[:, layout.walls].reshape(rows, 1, slots, 2)

    image = reflect(anchor[:, :, None, :], wall)  # (R, K, L, 2)
    first, second = wall[:, :, :, None, :], wall[:, :, None, :, :]  # of a pair (l, m)
    double = reflect(image[:, :, :, None, :], second)  # (R, K, L, M, 2)
    sources = np.concatenate(
        [anchor[:, :, None], image, double.reshape(rows, anchors, slots**2, 2)], axis=2
    )  # (R, K, F, 2)
    offset = position[:, :, None, :] - sources
    square = np.sum(offset * offset, axis=-1) + height2[:, :, None]
    length = np.sqrt(np.maximum(square, 1e-6))
    ray = offset / length[..., None]  # d length / d position
    ray_double = ray[:, :, 1 + slots :].reshape(rows, anchors, slots, slots, 2)
    before = _flip(ray_double, second)  # seen from between the two bounces

    jacobian = np.zeros((rows, anchors, layout.features, layout.size))
    jacobian[..., 0:2] = ray
    by_anchor = np.concatenate(
        [
            ray[:, :, :1],
            _flip(ray[:, :, 1 : 1 + slots], wall),
            _flip(before, first).reshape(rows, anchors, slots**2, 2),
        ],
        axis=2,
    )
    for k in range(anchors):
        columns = layout.anchor(k)
        jacobian[:, k, :, columns.start : columns.start + 2] = -by_anchor[:, k]
        jacobian[:, k, :, columns.start + 2] = 0.5 / length[:, k]
    by_wall = -_by_wall(anchor[:, :, None, :], wall, ray[:, :, 1 : 1 + slots])
    by_first = -_by_wall(anchor[:, :, None, None, :], first, before)
    by_second = -_by_wall(image[:, :, :, None, :], second, ray_double)
    pairs = jacobian[:, :, 1 + slots :].reshape(rows, anchors, slots, slots, layout.size)
    for slot in range(slots):
        columns = layout.wall(slot)
        jacobian[:, :, 1 + slot, columns] = by_wall[:, :, slot]
        pairs[:, :, slot, :, columns] += by_first[:, :, slot, :]
        pairs[:, :, :, slot, columns] += by_second[:, :, :, slot]
    jacobian[:, :, 1 + slots :] = pairs.reshape(rows, anchors, slots**2, layout.size)

    possible = np.ones((rows, anchors, layout.features), dtype=bool)
    agent_side = wall_side(position[:, :, None, :], wall)  # (R, 1, L)
    anchor_side = wall_side(anchor[:, :, None, :], wall)  # (R, K, L)
    possible[:, :, 1 : 1 + slots] = agent_side * anchor_side > 0.0
    image_side = wall_side(image[:, :, :, None, :], second)  # (R, K, L, M), image beyond m mirrored
    near = agent_side[:, :, None, :]
    fraction = near / np.where(np.abs(near + image_side) < 1e-9, 1e-9, near + image_side)
    agent = position[:, :, None, None, :]
    bounce = agent + fraction[..., None] * (double - agent)  # on wall m
    pair_possible = (near * image_side > 0.0) & (wall_side(bounce, first) * anchor_side[:, :, :, None] > 0.0)
    pair_possible &= ~np.eye(slots, dtype=bool)
    possible[:, :, 1 + slots :] = pair_possible.reshape(rows, anchors, slots**2)
    return Prediction(length, jacobian, possible)
