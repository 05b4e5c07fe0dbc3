"""Which legs of paths are blocked: walls lie in the cells of a grid, and a leg asks its neighbours alone.

A leg walks through the cells that it crosses, and the surfaces in them are tested. What that costs
grows with the walls near the leg, not with those of the building.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from raytrace.propagation.reflectors import RIM_M, TIP, Surfaces

__all__ = ["blocked"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def blocked(
    surfaces: Surfaces,
    start: Array,
    end: Array,
    rim_m: float = RIM_M,
    own: Indices | None = None,
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
    slabs = np.flatnonzero(surfaces.is_slab)
    low, size, counts, first, members = _cells(surfaces)
    met = _any_met(*arrays, slabs, low, size, counts, first, members, legs[0], legs[1], float(rim_m), own)
    return np.asarray(met).reshape(shape)


@lru_cache(maxsize=4)  # batches of one plan, one after the other, share its grid
def _cells(surfaces: Surfaces) -> tuple[Array, float, Indices, Indices, Indices]:
    """A grid of about as many cells as walls over the plan.

    Returns its lower corner (2,), the size of a cell, metres, the numbers of cells (2,), and the walls
    of the cells, row after row: those in ``members`` from ``first[cell]`` on to the next cell's.
    """
    walls = np.flatnonzero(~surfaces.is_slab)
    start = surfaces.origin[walls, :2]
    end = start + (surfaces.sides[:, 0] * surfaces.lengths[:, :1])[walls, :2]
    low = np.minimum(start, end).min(axis=0)
    extent = np.maximum(start, end).max(axis=0) - low
    size = max(float(np.sqrt(extent.prod() / len(walls))), float(extent.max()) / len(walls))
    counts = np.floor(extent / size).astype(np.int64) + 1
    return low, size, counts, *_sorted_in(walls, start, end, low, size, counts)


@compiled
def _sorted_in(
    walls: Indices, start: Array, end: Array, low: Array, size: float, counts: Indices
) -> tuple[Indices, Indices]:
    """Walls by cell, as :func:`_cells`; a cell has the walls that come as near its middle as its corners."""
    first = np.zeros(counts[0] * counts[1] + 1, dtype=np.int64)
    members = np.empty(0, dtype=np.int64)
    reach = size * (math.sqrt(0.5) + TIP)
    for fill in range(2):  # count, then write
        for row in range(len(walls)):
            x0, y0 = start[row] - low
            dx, dy = end[row] - start[row]
            square = dx * dx + dy * dy
            for i in range(max(0, int(min(x0, x0 + dx) / size) - 1), counts[0]):
                if i * size > max(x0, x0 + dx) + size:
                    break
                for j in range(max(0, int(min(y0, y0 + dy) / size) - 1), counts[1]):
                    if j * size > max(y0, y0 + dy) + size:
                        break
                    x, y = (i + 0.5) * size - x0, (j + 0.5) * size - y0
                    along = min(1.0, max(0.0, (x * dx + y * dy) / square))
                    if (x - along * dx) ** 2 + (y - along * dy) ** 2 > reach * reach:
                        continue
                    cell = i * counts[1] + j
                    if fill:
                        members[first[cell]] = walls[row]
                        first[cell] += 1
                    else:
                        first[cell + 1] += 1
        if not fill:
            first = np.cumsum(first)
            members = np.empty(first[-1], dtype=np.int64)
    first[1:] = first[:-1].copy()
    first[0] = 0
    return first, members


@compiled
def _any_met(
    origin: Array,
    sides: Array,
    lengths: Array,
    normal: Array,
    slabs: Indices,
    low: Array,
    size: float,
    counts: Indices,
    first: Indices,
    members: Indices,
    start: Array,
    end: Array,
    rim_m: float,
    own: Indices,
) -> NDArray[np.bool_]:
    """:func:`blocked` of legs from (n, 3) to (n, 3)."""
    met = np.zeros(len(start), dtype=np.bool_)
    asked = np.full(len(origin), -1)  # the last leg for which a surface was tested
    columns, rows = counts
    reach = 3.0 * abs(rim_m) + RIM_M
    for leg in range(len(start)):
        for surface in slabs:
            if _meets(origin, sides, lengths, normal, surface, start[leg], end[leg], rim_m, own[leg]):
                met[leg] = True
                break
        if met[leg]:
            continue
        x0, y0 = start[leg, 0] - low[0], start[leg, 1] - low[1]
        dx, dy = end[leg, 0] - start[leg, 0], end[leg, 1] - start[leg, 1]
        left, right = min(x0, x0 + dx) - reach, max(x0, x0 + dx) + reach
        for i in range(max(0, int(left / size)), min(columns - 1, math.floor(right / size)) + 1):
            near, far = 0.0, 1.0  # the part of the leg over this column
            if abs(dx) > RIM_M:
                one, other = (i * size - reach - x0) / dx, ((i + 1) * size + reach - x0) / dx
                near, far = max(0.0, min(one, other)), min(1.0, max(one, other))
            below = min(y0 + near * dy, y0 + far * dy) - reach
            above = max(y0 + near * dy, y0 + far * dy) + reach
            for j in range(max(0, int(below / size)), min(rows - 1, math.floor(above / size)) + 1):
                for at in range(first[i * rows + j], first[i * rows + j + 1]):
                    surface = members[at]
                    if asked[surface] == leg:
                        continue
                    asked[surface] = leg
                    if _meets(origin, sides, lengths, normal, surface, start[leg], end[leg], rim_m, own[leg]):
                        met[leg] = True
                        break
                if met[leg]:
                    break
            if met[leg]:
                break
    return met


@compiled
def _meets(
    origin: Array,
    sides: Array,
    lengths: Array,
    normal: Array,
    surface: int,
    start: Array,
    end: Array,
    rim_m: float,
    own: Indices,
) -> bool:
    """Whether one leg meets one surface."""
    x0, y0, z0 = start
    x1, y1, z1 = end
    nx, ny, nz = normal[surface]
    ox, oy, oz = origin[surface]
    before = (x0 - ox) * nx + (y0 - oy) * ny + (z0 - oz) * nz  # signed distances of the ends
    after = (x1 - ox) * nx + (y1 - oy) * ny + (z1 - oz) * nz
    slope = abs(after - before)
    low, high, margin = 0.0, 1.0, rim_m  # the part of the leg that may meet the surface
    if not (abs(before) <= rim_m and abs(after) <= rim_m):  # else it runs within the plane
        if slope <= 0.0:
            return False
        near = rim_m / slope
        crossing = before / (before - after)
        # Where a leg bounces it may meet another surface, at whose foot it does.
        first = -near if own[0] >= 0 else TIP
        last = 1.0 + near if own[1] >= 0 else 1.0 - TIP
        if crossing <= first or crossing >= last:
            return False
        if rim_m >= 0.0:  # what of the leg is as near the plane as the rim
            low, high = max(0.0, crossing - near), min(1.0, crossing + near)
        else:
            low = high = crossing
            length = math.sqrt((x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2)
            margin = near * length
    for side in range(2):
        sx, sy, sz = sides[surface, side]
        one = (x0 - ox) * sx + (y0 - oy) * sy + (z0 - oz) * sz
        other = (x1 - ox) * sx + (y1 - oy) * sy + (z1 - oz) * sz
        a, b = one + low * (other - one), one + high * (other - one)
        if max(a, b) < -margin or min(a, b) > lengths[surface, side] + margin:
            return False
    for bounce in range(2):  # not what a leg starts or ends on, or what lies in that plane
        wall = own[bounce]
        if wall >= 0:
            wx, wy, wz = normal[wall]
            dx, dy, dz = ox - origin[wall, 0], oy - origin[wall, 1], oz - origin[wall, 2]
            parallel = abs(nx * wx + ny * wy + nz * wz) > 1.0 - TIP
            if parallel and abs(dx * wx + dy * wy + dz * wz) < RIM_M:
                return False
    return True
