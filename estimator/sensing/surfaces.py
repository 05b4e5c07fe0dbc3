"""From reflecting-surface points to walls: the geometry of (8)-(10), (19), (20) and its derivatives.

Two points of a wall determine the mirror image of RP in it, the virtual reference point (VRP):
it lies on the perpendicular of their connection through RP, (9), and half-way to it is the
wall, (10). The solution is a quotient of polynomials, (19) and (20); its gradient
is given by the constants ``a1 .. c4`` of Appendix B, (65)-(78), which Theorem 2 puts together:

    p_vrp ~ p0 + w Q,   w = [x1 - mu_x1, x2 - mu_x2, y1 - mu_y1, y2 - mu_y2].      (21)-(23)

Equation numbers refer to the paper named in :mod:`estimator.sensing.ranges`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.geometry import vrp_of_line

__all__ = ["PairSolution", "pair_solution", "reflection_points"]

Array = NDArray[np.float64]


def reflection_points(
    distance_m: ArrayLike, azimuth_rad: ArrayLike, position_m: ArrayLike = (0.0, 0.0)
) -> Array:
    """Points at given distances and directions from the agent, equation (8).

    Parameters
    ----------
    distance_m, azimuth_rad : array_like, shape (...)
        Distances, metres, and directions, radians.
    position_m : array_like, shape (2,)
        The agent, metres.

    Returns
    -------
    ndarray, shape (..., 2)
    """
    azimuth = np.asarray(azimuth_rad, dtype=np.float64)
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    return np.asarray(position_m + np.asarray(distance_m, dtype=np.float64)[..., None] * towards)


@dataclass(frozen=True, eq=False)
class PairSolution:
    """The linear approximation of a VRP about a pair of RSPs (Theorem 2).

    Parameters
    ----------
    mean_m : ndarray, shape (..., 2)
        ``p0``: (19) and (20) at the pair.
    gradient : ndarray, shape (..., 4, 2)
        ``Q = [q_x, q_y]``, (22) and (23): derivatives by ``x1, x2, y1, y2``.
    """

    mean_m: Array
    gradient: Array


def pair_solution(
    first_m: ArrayLike, second_m: ArrayLike, reference_m: ArrayLike = (0.0, 0.0)
) -> PairSolution:
    """Value and gradient of (19), (20) by the constants of Appendix B.

    Parameters
    ----------
    first_m, second_m : array_like, shape (..., 2)
        The RSPs, metres, distinct.
    reference_m : array_like, shape (2,)
        RP, metres.

    Returns
    -------
    PairSolution

    Raises
    ------
    InputError
        If two points coincide.
    """
    first, second = np.broadcast_arrays(np.asarray(first_m, np.float64), np.asarray(second_m, np.float64))
    if first.shape[-1:] != (2,):
        raise InputError(f"first_m, second_m: expected shape (..., 2), got {first.shape}")
    x_rp, y_rp = np.asarray(reference_m, dtype=np.float64)
    x1, y1 = first[..., 0], first[..., 1]
    dx, dy = second[..., 0] - x1, second[..., 1] - y1
    b0 = dx**2 + dy**2  # (69)
    if np.any(b0 == 0.0):
        raise InputError("first_m, second_m: expected distinct points, got coinciding ones")
    vrp = vrp_of_line(first, second, reference_m)  # (19), (20)
    y2, x2 = second[..., 1], second[..., 0]
    a = (
        -2.0 * x_rp * dx + 2.0 * dy**2 - 2.0 * (y_rp - y1) * dy,  # (65)
        2.0 * x_rp * dx + 2.0 * (y_rp - y1) * dy,  # (66)
        2.0 * (x_rp - 2.0 * x1) * dy + 2.0 * dx * (-y2 - y_rp + 2.0 * y1),  # (67)
        -2.0 * (x_rp - 2.0 * x1) * dy + 2.0 * (y_rp - y1) * dx,  # (68)
    )
    b = (-2.0 * dx, 2.0 * dx, -2.0 * dy, 2.0 * dy)  # (70)-(73)
    c = (
        2.0 * (y_rp - 2.0 * y1) * dx + 2.0 * dy * (-x2 - x_rp + 2.0 * x1),  # (75)
        -2.0 * (y_rp - 2.0 * y1) * dx + 2.0 * (x_rp - x1) * dy,  # (76)
        -2.0 * y_rp * dy + 2.0 * dx**2 - 2.0 * (x_rp - x1) * dx,  # (77)
        2.0 * y_rp * dy + 2.0 * (x_rp - x1) * dx,  # (78)
    )
    q_x = [(a_i - vrp[..., 0] * b_i) / b0 for a_i, b_i in zip(a, b, strict=True)]  # (22)
    q_y = [(c_i - vrp[..., 1] * b_i) / b0 for c_i, b_i in zip(c, b, strict=True)]  # (23)
    gradient = np.stack([np.stack(q_x, axis=-1), np.stack(q_y, axis=-1)], axis=-1)
    return PairSolution(vrp, gradient)
