"""The reflecting rectangles of a plan: walls, floor and ceiling, and what meets them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan

__all__ = ["RIM_M", "TIP", "Surfaces", "first_hits", "mirrored", "on_rectangle", "surfaces_of"]

Array = NDArray[np.float64]

RIM_M = 1e-6
"""What meets a surface's rim to within this, metres, is taken to meet it."""
TIP = 1e-9
"""Fraction of a leg ignored at either end when it is tested for obstacles: it starts on a surface."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Rectangles in space: every wall, then floor, then ceiling.

    Parameters
    ----------
    origin : ndarray, shape (surfaces, 3)
        One corner, metres.
    sides : ndarray, shape (surfaces, 2, 3)
        Unit vectors along the two sides that meet there.
    lengths : ndarray, shape (surfaces, 2)
        Lengths of these sides, metres.
    normal : ndarray, shape (surfaces, 3)
        Unit normal, the cross product of the sides.
    """

    origin: Array
    sides: Array
    lengths: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.origin)

    @property
    def is_slab(self) -> NDArray[np.bool_]:
        """Which surfaces are a floor or a ceiling, shape (surfaces,)."""
        return np.asarray(np.abs(self.normal[:, 2]) > 0.5)

    def corners(self) -> Array:
        """The four corners of every rectangle in turn, shape (surfaces, 4, 3), metres."""
        first, second = np.moveaxis(self.sides * self.lengths[..., None], 1, 0)
        steps = [np.zeros_like(first), first, first + second, second]
        return np.stack([self.origin + step for step in steps], axis=1)


def surfaces_of(plan: FloorPlan) -> Surfaces:
    """The reflecting rectangles of a plan, in the order of ``plan.surface_names``.

    Floor and ceiling are the bounding rectangle of the walls; the walls confine what
    can be reached of them.
    """
    start, end = plan.walls_m()
    low, high = np.minimum(start, end).min(axis=0), np.maximum(start, end).max(axis=0)
    rectangles = [
        ((*a, 0.0), (*(b - a), 0.0), (0.0, 0.0, wall.height_m))
        for wall, a, b in zip(plan.walls, start, end, strict=True)
    ]
    width, depth = high - low
    if plan.has_floor:
        rectangles.append(((*low, 0.0), (width, 0.0, 0.0), (0.0, depth, 0.0)))
    if plan.has_ceiling:
        rectangles.append(((*low, plan.ceiling_height_m), (width, 0.0, 0.0), (0.0, depth, 0.0)))
    origin, first, second = np.moveaxis(np.array(rectangles, dtype=np.float64), 1, 0)
    sides = np.stack([first, second], axis=1)
    lengths = np.linalg.norm(sides, axis=-1)
    sides /= lengths[..., None]
    return Surfaces(origin, sides, lengths, np.cross(sides[:, 0], sides[:, 1]))


def mirrored(surfaces: Surfaces, points: Array, index: NDArray[np.int64]) -> Array:
    """Images (q, 3) of points in the planes of surfaces ``index`` (q,)."""
    normal = surfaces.normal[index]
    height = np.sum((points - surfaces.origin[index]) * normal, axis=-1)
    return np.asarray(points - 2.0 * height[:, None] * normal)


def on_rectangle(
    surfaces: Surfaces, index: NDArray[np.int64], points: Array, margin_m: Array
) -> NDArray[np.bool_]:
    """Whether points in the planes of surfaces ``index`` lie on the rectangles, grown by a margin."""
    offset = points - surfaces.origin[index]
    along = np.einsum("nd,nsd->ns", offset, surfaces.sides[index])
    margin_m = margin_m[:, None]
    within = (along >= -margin_m) & (along <= surfaces.lengths[index] + margin_m)
    return np.asarray(within.all(axis=-1))


def first_hits(surfaces: Surfaces, origin: Array, directions: Array) -> tuple[Array, Array]:
    """Where rays from a point (3,) along unit vectors (n, 3) first meet a surface.

    Returns
    -------
    distance_m : ndarray, shape (n,)
        Infinite where a ray meets nothing.
    cosine : ndarray, shape (n,)
        Cosine of the angle between ray and normal (0 where it meets nothing).
    """
    slope = directions @ surfaces.normal.T
    gap = np.sum((surfaces.origin - origin) * surfaces.normal, axis=-1)
    distance = np.divide(gap, slope, out=np.full(slope.shape, np.inf), where=slope != 0.0)
    point = origin + np.where(np.isfinite(distance), distance, 0.0)[..., None] * directions[:, None]
    along = np.einsum("rsd,skd->rsk", point - surfaces.origin, surfaces.sides)
    met = (
        np.isfinite(distance) & (distance > 0.0) & ((along >= 0.0) & (along <= surfaces.lengths)).all(axis=-1)
    )
    distance = np.where(met, distance, np.inf)
    nearest, rays = np.argmin(distance, axis=1), np.arange(len(directions))
    first = distance[rays, nearest]
    return first, np.where(np.isfinite(first), np.abs(slope[rays, nearest]), 0.0)
