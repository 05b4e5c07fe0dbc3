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

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "mirror",
    "mirror_in_wall",
    "mirror_xy",
    "rotate",
    "rotate_by_angle_of",
    "rotation_matrix",
    "segments_cross",
    "vrp_by_image",
    "vrp_by_point",
    "vrp_of_image",
    "vrp_of_line",
    "wall_normal",
]

Array = NDArray[np.float64]
Scalars = TypeVar("Scalars", float, Array)


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


def mirror_xy(x: Scalars, y: Scalars, vrp_x: Scalars, vrp_y: Scalars) -> tuple[Scalars, Scalars]:
    """Coordinates of mirror images in walls half-way between the origin and their VRPs (equation (2)).

    The one definition of a mirror image. It takes numbers or arrays that broadcast, and may be compiled.

    Parameters
    ----------
    x, y : float or ndarray
        Points relative to RP, metres.
    vrp_x, vrp_y : float or ndarray
        VRPs relative to RP, metres.
    """
    scale = 1.0 - 2.0 * (x * vrp_x + y * vrp_y) / (vrp_x * vrp_x + vrp_y * vrp_y)
    return x + scale * vrp_x, y + scale * vrp_y


def mirror(points: ArrayLike, vrp: ArrayLike, reference: ArrayLike = (0.0, 0.0)) -> Array:
    """Mirror images of points in the walls of given VRPs (equation (2)).

    Applied to an anchor it gives the virtual anchor; it is its own inverse, (4).

    Parameters
    ----------
    points : array_like, shape (..., 2)
        Positions, metres.
    vrp : array_like, shape (..., 2)
        VRPs, metres; leading axes broadcast with ``points``.
    reference : array_like, shape (..., 2)
        Reference points, metres.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    origin = np.asarray(reference, dtype=np.float64)
    point = np.asarray(points, dtype=np.float64) - origin
    wall = np.asarray(vrp, dtype=np.float64) - origin
    image = mirror_xy(point[..., 0], point[..., 1], wall[..., 0], wall[..., 1])
    return np.asarray(np.stack(image, axis=-1) + origin)


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
    foot = np.asarray(start, dtype=np.float64)
    along = np.asarray(end, dtype=np.float64) - foot
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    return mirror(points, foot - normal, foot + normal)


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


def vrp_of_image(image: Array, point: Array) -> Array:
    """VRPs of the walls half-way between points and their mirror images, (3), RP at the origin.

    Parameters
    ----------
    image, point : ndarray, shape (..., 2)
        An anchor's virtual anchor and the anchor, or the agent's image and the agent, metres.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    chord = image - point
    rise = np.sum(image * image, axis=-1) - np.sum(point * point, axis=-1)
    return np.asarray((rise / np.sum(chord * chord, axis=-1))[..., None] * chord)


def vrp_by_image(image: Array, point: Array) -> Array:
    """Jacobians (..., 2, 2) of VRPs by the images (..., 2) of points (..., 2) that stay."""
    chord = image - point
    square = np.sum(chord * chord, axis=-1)[..., None, None]
    rise = (np.sum(image * image, axis=-1) - np.sum(point * point, axis=-1))[..., None, None]
    by_scale = 2.0 * (image[..., None, :] - rise / square * chord[..., None, :])
    return np.asarray((chord[..., :, None] * by_scale + rise * np.eye(2)) / square)


def vrp_by_point(image: Array, point: Array) -> Array:
    """Jacobians (..., 2, 2) of VRPs by points (..., 2), of images (..., 2) that stay."""
    return vrp_by_image(point, image)  # the wall is that of the two exchanged


def rotation_matrix(angle_rad: float) -> Array:
    """The 2 x 2 matrix that rotates column vectors counter-clockwise by ``angle_rad``."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def rotate(points: ArrayLike, angle_rad: float, reference: ArrayLike = (0.0, 0.0)) -> Array:
    """Points rotated counter-clockwise about ``reference``; shapes as in :func:`mirror`."""
    p = np.asarray(points, dtype=np.float64)
    r = np.asarray(reference, dtype=np.float64)
    return np.asarray((p - r) @ rotation_matrix(angle_rad).T + r)


def rotate_by_angle_of(
    vector: Array, angle: int, columns: Sequence[slice], offset_rad: float = 0.0
) -> tuple[Array, Array]:
    """Points of a state vector rotated about the origin by an angle that is one of its elements.

    This is how a state in the gauge frame is told in the estimator's frame.

    Parameters
    ----------
    vector : ndarray, shape (n,)
        State vector.
    angle : int
        Index of the angle in it, radians.
    columns : sequence of slice
        Where its points (or velocities) stand, two elements each.
    offset_rad : float
        Known angle that is added.

    Returns
    -------
    points : ndarray, shape (2 P,)
        The rotated points.
    jacobian : ndarray, shape (2 P, n)
        Their derivatives by the state vector.
    """
    turn = rotation_matrix(offset_rad + float(vector[angle]))
    points = np.empty(2 * len(columns))
    jacobian = np.zeros((2 * len(columns), len(vector)))
    for i, place in enumerate(columns):
        rows = slice(2 * i, 2 * i + 2)
        points[rows] = turn @ vector[place]
        jacobian[rows, place] = turn
        jacobian[rows, angle] = -points[2 * i + 1], points[2 * i]
    return points, jacobian


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
