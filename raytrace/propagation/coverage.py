"""Coverage: what part of an anchor's power reaches each place of a plan, phases averaged out."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.space import confined
from raytrace.propagation.images import image_paths

__all__ = ["lattice", "path_gains"]

Array = NDArray[np.float64]
_MOST_PIXELS = 20_000
_AT_ONCE = 1024  # places whose paths are in memory at the same time


def lattice(plan: FloorPlan, step_m: float | None = None) -> tuple[Array, Array]:
    """Places (X,) and (Y,) over walls, anchors and walk of a plan, metres.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    step_m : float, optional
        From place to place, metres; by default as fine as a picture needs.
    """
    low, high = _extent(plan)
    size = high - low
    pitch = float(max(np.sqrt(size[0] * size[1] / _MOST_PIXELS), 0.05)) if step_m is None else step_m
    x, y = (np.arange(low[axis] + 0.5 * pitch, high[axis], pitch) for axis in range(2))
    return x, y


def path_gains(plan: FloorPlan, x_m: Array, y_m: Array, depth: int | None = None) -> Array:
    """Powers of all paths from each anchor, over what it sends.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    x_m, y_m : ndarray, shapes (X,) and (Y,)
        Places of a lattice, metres.
    depth : int, optional
        Most bounces; by default the plan's.

    Returns
    -------
    ndarray, shape (X, Y, anchors)
        Sums of squared amplitudes; NaN outside of the walls (in scenes where the agent walks inside), 0 where
        no path arrives.
    """
    places = np.stack(np.meshgrid(x_m, y_m, indexing="ij"), axis=-1)
    room = confined(*plan.walls_m())
    if not shapely.contains_xy(room, *plan.track()[0, :2]):
        room = shapely.box(*np.concatenate(_extent(plan)))
    shapely.prepare(room)
    inside = shapely.contains_xy(room, places[..., 0], places[..., 1])
    positions = np.column_stack([places[inside], np.full(int(inside.sum()), plan.agent.height_m)])
    reached = np.zeros((len(positions), len(plan.anchors)))
    for first in range(0, len(positions), _AT_ONCE):
        paths = image_paths(plan, positions[first : first + _AT_ONCE], depth).flat()
        np.add.at(reached, (first + paths.epoch, paths.anchor), np.abs(paths.amplitude) ** 2)
    gain = np.full((*inside.shape, len(plan.anchors)), np.nan)
    gain[inside] = reached
    return gain


def _extent(plan: FloorPlan) -> tuple[Array, Array]:
    corners = np.vstack([*plan.walls_m(), plan.track()[:, :2], plan.anchors_m()[:, :2]])
    return corners.min(axis=0), corners.max(axis=0)
