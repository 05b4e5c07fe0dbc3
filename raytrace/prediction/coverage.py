"""Coverage: the gain of the strongest anchor on a grid over a plan."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.space import confined
from raytrace.prediction.channels import grid_axes, predict

__all__ = ["coverage", "decibels", "inside"]

Array = NDArray[np.float64]
_AT_ONCE = 256  # points predicted together: all their paths are in memory


def coverage(plan: FloorPlan, step_m: float = 0.5) -> tuple[Array, Array, Array]:
    """The gain of the strongest anchor where a person may be.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    step_m : float
        Distance between points, metres.

    Returns
    -------
    x_m, y_m : ndarray, shapes (X,) and (Y,)
        Coordinates of the grid, metres.
    gain_db : ndarray, shape (Y, X)
        Sum of the powers of all paths of the strongest anchor over its EIRP, dB; NaN where there is none, and
        outside of what the walls confine round the walk (of their convex hull, if they leave it open).
    """
    x, y = grid_axes(plan, step_m)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    start, end = plan.walls_m()
    area = confined(start, end)
    if not shapely.contains_xy(area, *plan.track()[0, :2]):
        area = shapely.convex_hull(shapely.multipoints(np.concatenate([start, end])))
    within = np.asarray(shapely.contains_xy(area, points[:, 0], points[:, 1]))
    power = np.zeros(len(points))
    for places in np.array_split(np.flatnonzero(within), -(-int(within.sum()) // _AT_ONCE) or 1):
        if len(places):
            power[places] = predict(plan, points[places]).power.max(axis=1, initial=0.0)
    return x, y, decibels(power, within).reshape(len(y), len(x))


def inside(plan: FloorPlan, points: Array) -> NDArray[np.bool_]:
    """Which points (T, 2) the walls confine."""
    return np.asarray(shapely.contains_xy(confined(*plan.walls_m()), points[:, 0], points[:, 1]))


def decibels(power: Array, shown: NDArray[np.bool_]) -> Array:
    """Powers in dB; NaN where there is none, or it is not to be shown."""
    known = shown & (power > 0.0)
    return np.where(known, 10.0 * np.log10(np.where(known, power, 1.0)), np.nan)
