"""Mirror images, walls as lines and segments, and rotations about the reference point.

A wall is the line of points equally far from the reference point (RP, the start of
the agent) and from its mirror image, the virtual reference point (VRP), equations
(1)-(4) of the paper:

    J. Yang, C.-K. Wen, S. Jin, "Hybrid Active and Passive Sensing for SLAM in
    Wireless Communication Systems".

All positions are metres in one planar frame; arrays end in an axis of length 2
(x, y) and broadcast over their leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "mirror",
    "mirror_in_wall",
    "rotate",
    "rotation_matrix",
    "segments_cross",
    "vrp_of_line",
    "wall_normal",
]

Array = NDArray[np.float64]


def wall_normal(vrp: ArrayLike, reference: ArrayLike = (0.0, 0.0)) -> Array:
    """Unit normal of a wall, pointing from RP to VRP (equation (1)).

    Parameters
    ----------
    vrp : array_like, shape (..., 2)
        Virtual reference point, metres; must differ from ``reference``.
    reference : array_like, shape (2,)
        Reference point, metres.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    offset = np.asarray(vrp, dtype=np.float64) - np.asarray(reference, dtype=np.float64)
    return np.asarray(offset / np.linalg.norm(offset, axis=-1, keepdims=True))


def mirror(points: ArrayLike, vrp: ArrayLike, reference: ArrayLike = (0.0, 0.0)) -> Array:
    """Mirror images of points in the walls of given VRPs (equation (2)).

    Applied to an anchor it gives the virtual anchor; it is its own inverse, (4).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Positions, metres.
    vrp : array_like, shape (..., 2)
        VRPs, metres; leading axes broadcast with ``points``.
    reference : array_like, shape (2,)
        Reference point, metres.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    p = np.asarray(points, dtype=np.float64)
    v = np.asarray(vrp, dtype=np.float64)
    r = np.asarray(reference, dtype=np.float64)
    normal = wall_normal(v, r)
    height = np.sum((p - 0.5 * (v + r)) * normal, axis=-1, keepdims=True)
    return np.asarray(p - 2.0 * height * normal)


def mirror_in_wall(points: ArrayLike, start: ArrayLike, end: ArrayLike) -> Array:
    """Mirror images of points in the lines through ``start`` and ``end``.

    Parameters
    ----------
    points, start, end : array_like, shape (..., 2)
        Positions, metres; leading axes broadcast.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    p = np.asarray(points, dtype=np.float64)
    a = np.asarray(start, dtype=np.float64)
    along = np.asarray(end, dtype=np.float64) - a
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    height = np.sum((p - a) * normal, axis=-1, keepdims=True)
    return np.asarray(p - 2.0 * height * normal)


def vrp_of_line(start: ArrayLike, end: ArrayLike, reference: ArrayLike = (0.0, 0.0)) -> Array:
    """VRP of the wall through two points: the mirror image of RP (equation (3)).

    Parameters
    ----------
    start, end : array_like, shape (..., 2)
        Two points of the wall, metres.
    reference : array_like, shape (2,)
        Reference point, metres.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    return mirror_in_wall(reference, start, end)


def rotation_matrix(angle_rad: float) -> Array:
    """The 2 x 2 matrix that rotates column vectors counter-clockwise by ``angle_rad``."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def rotate(points: ArrayLike, angle_rad: float, reference: ArrayLike = (0.0, 0.0)) -> Array:
    """Points rotated counter-clockwise about ``reference``; shapes as in :func:`mirror`."""
    p = np.asarray(points, dtype=np.float64)
    r = np.asarray(reference, dtype=np.float64)
    return np.asarray((p - r) @ rotation_matrix(angle_rad).T + r)


def segments_cross(
    a0: ArrayLike, a1: ArrayLike, b0: ArrayLike, b1: ArrayLike, margin: float = 1e-9
) -> NDArray[np.bool_]:
    """Whether open segments ``a0 a1`` meet closed segments ``b0 b1``.

    Points of ``a`` within a fraction ``margin`` of either end do not count, so that a
    path may start or end on a wall. Parallel segments do not cross.

    Parameters
    ----------
    a0, a1, b0, b1 : array_like, shape (..., 2)
        End points, metres; leading axes broadcast.
    margin : float
        Fraction of segment ``a`` ignored at both of its ends.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    p, q = np.asarray(a0, dtype=np.float64), np.asarray(b0, dtype=np.float64)
    r, s = np.asarray(a1, dtype=np.float64) - p, np.asarray(b1, dtype=np.float64) - q
    gap = q - p
    determinant = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    parallel = np.abs(determinant) < 1e-12
    safe = np.where(parallel, 1.0, determinant)
    t = (gap[..., 0] * s[..., 1] - gap[..., 1] * s[..., 0]) / safe
    u = (gap[..., 0] * r[..., 1] - gap[..., 1] * r[..., 0]) / safe
    hit = (t > margin) & (t < 1.0 - margin) & (u >= 0.0) & (u <= 1.0)
    return np.asarray(hit & ~parallel)
