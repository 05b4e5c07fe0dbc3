"""Estimated walls as lines: where their points are, where they were seen, how sure they are.

A VRP ``v`` stands for the line half-way between RP and ``v``, perpendicular to their
connection. With the normal ``n = v / |v|`` and the tangent ``tau`` (``n`` turned by +90
degrees), its points are ``v / 2 + t tau``, ``t`` in metres from the foot of the
perpendicular. All positions are in the estimator's frame (RP is the origin).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.geometry import mirror, wall_normal
from estimator.result import SlamResult

__all__ = ["line_points", "line_std", "seen_span"]

Array = NDArray[np.float64]


def _tangent(vrp: Array) -> Array:
    normal = wall_normal(vrp)
    return np.array([-normal[1], normal[0]])


def line_points(vrp: ArrayLike, along_m: ArrayLike) -> Array:
    """Points of a wall.

    Parameters
    ----------
    vrp : array_like, shape (2,)
        VRP, metres.
    along_m : array_like, shape (n,)
        Coordinates ``t`` along the wall, metres.

    Returns
    -------
    ndarray, shape (n, 2)
    """
    v = np.asarray(vrp, dtype=np.float64)
    return 0.5 * v + np.asarray(along_m, dtype=np.float64)[:, None] * _tangent(v)


def line_std(vrp: ArrayLike, covariance: ArrayLike, along_m: ArrayLike) -> Array:
    """Standard deviation of a wall's line, measured across it.

    Moving the VRP by ``dv`` moves the point at ``t`` across the wall by
    ``(n / 2 - t tau / |v|) . dv`` to first order.

    Parameters
    ----------
    vrp : array_like, shape (2,)
        VRP, metres.
    covariance : array_like, shape (2, 2)
        Its covariance, square metres.
    along_m : array_like, shape (n,)
        Coordinates ``t`` along the wall, metres.

    Returns
    -------
    ndarray, shape (n,)
        Metres.
    """
    v, along = np.asarray(vrp, dtype=np.float64), np.asarray(along_m, dtype=np.float64)
    gradient = 0.5 * wall_normal(v) - along[:, None] * _tangent(v) / np.linalg.norm(v)
    variance = np.einsum("ni,ij,nj->n", gradient, np.asarray(covariance, dtype=np.float64), gradient)
    return np.asarray(np.sqrt(variance))


def seen_span(result: SlamResult, wall: int, opening_m: float = 8.0) -> tuple[float, float]:
    """Piece of a wall that carries the estimated reflection points.

    Reflection points of all anchors located at the last epoch are followed over the epochs
    at which the wall is confirmed. Where the agent walked through the line there is no wall:
    points within ``opening_m`` of such a place do not count.

    Parameters
    ----------
    result : SlamResult
        Estimates of one run.
    wall : int
        Column of the wall, valid at the last epoch.
    opening_m : float
        Assumed half-width of an opening that the agent went through, metres.

    Returns
    -------
    tuple of float
        From and to, coordinates ``t`` along the wall, metres; a short piece about the foot of
        the perpendicular if there is no reflection point.
    """
    vrp = result.wall_mean_m[-1, wall]
    normal, tangent = wall_normal(vrp), _tangent(vrp)
    half = 0.5 * float(np.linalg.norm(vrp))
    track = result.agent_mean[:, :2]
    agent = track[result.wall_valid[:, wall]]
    points = [np.zeros(0)]
    for place in result.anchor_mean_m[-1, result.anchor_valid[-1]]:
        image = mirror(place, vrp)
        behind, before = image @ normal - half, half - agent @ normal
        same_side = behind * before > 0.0
        share = behind / np.where(same_side, behind + before, 1.0)
        points.append(((image + share[:, None] * (agent - image)) @ tangent)[same_side])
    seen = np.concatenate(points)
    inside = track @ normal < half
    through = np.flatnonzero(inside[1:] != inside[:-1])
    for opening in track[through] @ tangent:
        seen = seen[np.abs(seen - opening) > opening_m]
    if seen.size == 0:
        return -0.1 * half, 0.1 * half
    return float(seen.min()), float(seen.max())
