"""The reflecting rectangles of a plan: walls, floor and ceiling, and what meets them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from raytrace.plan.floorplan import FloorPlan

__all__ = ["RIM_M", "TIP", "Surfaces", "blocked", "first_hits", "mirrored", "on_rectangle", "surfaces_of"]

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


def blocked(
    surfaces: Surfaces,
    start: Array,
    end: Array,
    rim_m: float = RIM_M,
    own: NDArray[np.int64] | None = None,
) -> NDArray[np.bool_]:
    """Whether legs meet any surface, grown by a rim, between their ends.

    A leg that runs within a surface meets it, and one that bounces at the foot of another surface
    meets that one; with a negative rim neither does.

    Parameters
    ----------
    surfaces : Surfaces
        The surfaces.
    start, end : ndarray, shape (..., 3)
        Ends of the legs, metres.
    rim_m : float
        By so much the surfaces are larger than they are, metres.
    own : ndarray of int64, shape (legs, 2), optional
        Surfaces on which the legs start and end, -1 for none: those a leg cannot meet.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    legs = np.ascontiguousarray(np.stack(np.broadcast_arrays(start, end)).reshape(2, -1, 3), np.float64)
    own = np.full((legs.shape[1], 2), -1) if own is None else np.ascontiguousarray(own, np.int64)
    shape = np.broadcast_shapes(np.shape(start), np.shape(end))[:-1]
    arrays = surfaces.origin, surfaces.sides, surfaces.lengths, surfaces.normal
    return np.asarray(_any_met(*arrays, legs[0], legs[1], float(rim_m), own)).reshape(shape)


@compiled
def _any_met(
    origin: Array,
    sides: Array,
    lengths: Array,
    normal: Array,
    start: Array,
    end: Array,
    rim_m: float,
    own: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """:func:`blocked` of legs from (n, 3) to (n, 3)."""
    met = np.zeros(len(start), dtype=np.bool_)
    for leg in range(len(start)):
        x0, y0, z0 = start[leg]
        x1, y1, z1 = end[leg]
        length = np.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2)
        for surface in range(len(origin)):
            nx, ny, nz = normal[surface]
            ox, oy, oz = origin[surface]
            before = (x0 - ox) * nx + (y0 - oy) * ny + (z0 - oz) * nz  # signed distances of the ends
            after = (x1 - ox) * nx + (y1 - oy) * ny + (z1 - oz) * nz
            slope = abs(after - before)
            inside = abs(before) <= rim_m and abs(after) <= rim_m  # the leg runs within the plane
            low, high = 0.0, 0.0  # the part of the leg that may meet the surface
            margin = rim_m
            if inside:
                high = 1.0
            elif slope > 0.0:
                near = rim_m / slope
                low = high = before / (before - after)
                # Where a leg bounces it may meet another surface, at whose foot it does.
                first = -near if own[leg, 0] >= 0 else TIP
                last = 1.0 + near if own[leg, 1] >= 0 else 1.0 - TIP
                if low <= first or low >= last:
                    continue
                margin = near * length
            else:
                continue
            overlaps = True
            for side in range(2):
                sx, sy, sz = sides[surface, side]
                one = (x0 - ox) * sx + (y0 - oy) * sy + (z0 - oz) * sz
                other = (x1 - ox) * sx + (y1 - oy) * sy + (z1 - oz) * sz
                a, b = one + low * (other - one), one + high * (other - one)
                if max(a, b) < -margin or min(a, b) > lengths[surface, side] + margin:
                    overlaps = False
                    break
            if not overlaps:
                continue
            ours = False  # what a leg starts or ends on, or what lies in that plane
            for bounce in range(2):
                wall = own[leg, bounce]
                if wall >= 0:
                    wx, wy, wz = normal[wall]
                    dx, dy, dz = ox - origin[wall, 0], oy - origin[wall, 1], oz - origin[wall, 2]
                    parallel = abs(nx * wx + ny * wy + nz * wz) > 1.0 - TIP
                    ours = ours or (parallel and abs(dx * wx + dy * wy + dz * wz) < RIM_M)
            if not ours:
                met[leg] = True
                break
    return met


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
