"""Where paths bounce: their vertices, from the surfaces that they meet.

Files name the surfaces of a path and not its points; with the ends they determine them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raytrace.floorplan import FloorPlan
from raytrace.images import surfaces_of
from raytrace.paths import NO_SURFACE, PathList

__all__ = ["bounce_points"]

Array = NDArray[np.float64]


def bounce_points(plan: FloorPlan, paths: PathList, positions_m: Array) -> Array:
    """Points at which specular paths bounce.

    Parameters
    ----------
    plan : FloorPlan
        The plan of the paths.
    paths : PathList
        The paths; ``epoch`` counts the positions, ``anchor`` the plan's anchors.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.

    Returns
    -------
    ndarray of float64, shape (paths, bounces, 3)
        From the anchor to the agent, plan frame, metres; NaN beyond a path's order.
    """
    surfaces = surfaces_of(plan)
    images = [plan.anchors_m()[paths.anchor]]
    for wall in paths.walls.T:
        normal, origin = surfaces.normal[wall], surfaces.origin[wall]
        height = np.sum((images[-1] - origin) * normal, axis=-1)
        images.append(images[-1] - np.where(wall == NO_SURFACE, 0.0, 2.0 * height)[:, None] * normal)
    points = np.full((*paths.walls.shape, 3), np.nan)
    point = positions_m[paths.epoch]
    for bounce in reversed(range(paths.walls.shape[1])):
        wall = paths.walls[:, bounce]
        normal, towards = surfaces.normal[wall], images[bounce + 1] - point
        gap = np.sum((surfaces.origin[wall] - point) * normal, axis=-1)
        slope = np.sum(towards * normal, axis=-1)
        met = wall != NO_SURFACE
        fraction = np.divide(gap, slope, out=np.zeros_like(gap), where=met)
        point = point + fraction[:, None] * towards
        points[met, bounce] = point[met]
    return points
