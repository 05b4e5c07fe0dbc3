"""Walls made sound: ends joined that nearly meet, and one surface where several were drawn.

A ray that meets two surfaces at one place picks either by chance, and a gap of a
tenth of a millimetre lets it out. So, when a plan is loaded:

1. ends within a millimetre of one another become one point, and an end within a millimetre of a wall
   moves onto it;
2. walls of one material, height and thickness that lie on one another become one;
3. of two that differ, the higher stays if they are of one material, else the shorter (a window in
   a wall), and the other is cut; two materials of two heights on one line are refused, since
   no vertical surface is both.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from raytrace.plan.errors import PlanFault
from raytrace.plan.surfaces import Wall

__all__ = ["Repairs", "sound_walls"]

Array = NDArray[np.float64]

# Ends nearer than this were meant to meet; those nearer than the other do.
_SNAP_M = 1e-3
_MET_M = 1e-6
# A repair can bring other ends near; two rounds settle all but artificial plans.
_MOST_ROUNDS = 8


@dataclass(frozen=True)
class Repairs:
    """What :func:`sound_walls` changed.

    Parameters
    ----------
    snapped : int
        Ends that were moved, by a millimetre at most.
    overlaps : tuple of str
        Walls that lay on one another, and what became of them, a line for each.
    """

    snapped: int = 0
    overlaps: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """All of it for people, a line each."""
        moved = f"{self.snapped} ends of walls moved by up to a millimetre to meet their neighbours"
        return [*([moved] if self.snapped else []), *self.overlaps]


def sound_walls(walls: Sequence[Wall]) -> tuple[tuple[Wall, ...], Repairs]:
    """Walls with ends joined and overlaps resolved, in their order, and what was changed.

    Raises
    ------
    PlanFault
        If walls of different materials and heights lie on one another.
    """
    current, snapped, overlaps = list(walls), 0, list[str]()
    for _ in range(_MOST_ROUNDS):
        current, moved = _snapped(current)
        current, told = _resolved(current)
        snapped += moved
        overlaps += told
        if not moved and not told:
            break
    return tuple(current), Repairs(snapped, tuple(overlaps))


def _ends(walls: Sequence[Wall]) -> Array:
    return np.array([(wall.from_m, wall.to_m) for wall in walls], dtype=np.float64)


def _moved(wall: Wall, start: Array, end: Array, **more: object) -> Wall:
    from_m, to_m = ((float(x), float(y)) for x, y in (start, end))
    return wall.model_copy(update={"from_m": from_m, "to_m": to_m, **more})


def _snapped(walls: list[Wall]) -> tuple[list[Wall], int]:
    """Ends led to the ends and walls they nearly meet; how many were moved."""
    ends = _ends(walls)
    points = ends.reshape(-1, 2)
    made = points.copy()
    places = shapely.points(points)
    one, other = shapely.STRtree(places).query(places, predicate="dwithin", distance=_SNAP_M)
    near = coo_array((np.ones(len(one)), (one, other)), shape=(len(points), len(points)))
    _, cluster = connected_components(near, directed=False)
    _, first, inverse = np.unique(cluster, return_index=True, return_inverse=True)
    made = points[first][inverse]
    lines = shapely.linestrings(made.reshape(-1, 2, 2))
    places = shapely.points(made)
    point, wall = shapely.STRtree(lines).query(places, predicate="dwithin", distance=_SNAP_M)
    at_end = np.linalg.norm(made[point][:, None] - made.reshape(-1, 2, 2)[wall], axis=-1).min(axis=1)
    joint = (at_end > _SNAP_M) & (shapely.distance(places[point], lines[wall]) > _MET_M)
    for index, onto in zip(point[joint], wall[joint], strict=True):
        start, end = made[2 * onto], made[2 * onto + 1]
        along = end - start
        made[index] = start + along * float((made[index] - start) @ along) / float(along @ along)
    moved = np.linalg.norm(made - points, axis=1) > _MET_M
    made[~moved] = points[~moved]
    changed = moved.reshape(-1, 2).any(axis=1)
    pairs = made.reshape(-1, 2, 2)
    return [_moved(wall, *pairs[row]) if changed[row] else wall for row, wall in enumerate(walls)], int(
        moved.sum()
    )


def _overlapping(ends: Array) -> list[tuple[int, int]]:
    """Pairs of walls that share more than a millimetre of one line."""
    lines = shapely.linestrings(ends)
    length = shapely.length(lines)
    one, other = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=_SNAP_M)
    keep = (one < other) & (np.minimum(length[one], length[other]) > _SNAP_M)
    one, other = one[keep], other[keep]
    swap = length[one] < length[other]
    long, short = np.where(swap, other, one), np.where(swap, one, other)
    along = (ends[long, 1] - ends[long, 0]) / length[long][:, None]
    offset = ends[short] - ends[long, :1]
    across = np.abs(along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]).max(axis=1)
    at = np.sort(np.einsum("nei,ni->ne", offset, along), axis=1)
    shared = np.minimum(at[:, 1], length[long]) - np.maximum(at[:, 0], 0.0)
    found = (across <= _SNAP_M) & (shared > _SNAP_M)
    return [(int(i), int(j)) for i, j in zip(one[found], other[found], strict=True)]


def _resolved(walls: list[Wall]) -> tuple[list[Wall], list[str]]:
    """One surface where several lie; what became of them."""
    ends = _ends(walls)
    pairs = _overlapping(ends)
    alike = [(i, j) for i, j in pairs if _slab(walls[i]) == _slab(walls[j])]
    if alike:
        return _united(walls, ends, alike)
    cuts: dict[int, list[int]] = defaultdict(list)
    told = []
    for i, j in pairs:
        stays, yields = sorted((i, j), key=lambda k: (-walls[k].height_m, np.ptp(ends[k], axis=0).max(), k))
        a, b = walls[stays], walls[yields]
        if a.material != b.material and a.height_m != b.height_m:
            raise PlanFault(
                f"walls: expected one surface at one place, got {walls[i].name!r} ({_told(walls[i])}) and "
                f"{walls[j].name!r} ({_told(walls[j])}) on one another: end one where the other begins"
            )
        cuts[yields].append(stays)
        told.append(f"walls {walls[i].name!r} and {walls[j].name!r} lie on one another: {b.name!r} was cut")
    names = {wall.name for wall in walls}
    made: list[Wall] = []
    for index, wall in enumerate(walls):
        made += [wall] if index not in cuts else _cut(wall, ends[index], ends[cuts[index]], names)
    if not made:
        raise PlanFault("walls: expected a wall that is left, got none")
    return made, told


def _slab(wall: Wall) -> tuple[str, float, float]:
    return wall.material, wall.height_m, wall.thickness_m


def _told(wall: Wall) -> str:
    return f"{wall.material}, {wall.height_m:g} m high"


def _united(walls: list[Wall], ends: Array, alike: list[tuple[int, int]]) -> tuple[list[Wall], list[str]]:
    """Walls that lie on one another and are the same become the first of them, extended."""
    rows, columns = np.array(alike).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(walls), len(walls)))
    _, group = connected_components(graph, directed=False)
    members: dict[int, list[int]] = defaultdict(list)
    for index, number in enumerate(group):
        members[int(number)].append(index)
    made = []
    for index, wall in enumerate(walls):
        mine = members[int(group[index])]
        if index != mine[0]:
            continue
        if len(mine) == 1:
            made.append(wall)
            continue
        points = ends[mine].reshape(-1, 2)
        longest = ends[max(mine, key=lambda k: float(np.linalg.norm(ends[k, 1] - ends[k, 0])))]
        at = points @ (longest[1] - longest[0])
        tips = points[int(np.argmin(at))], points[int(np.argmax(at))]
        backwards = float((ends[index, 1] - ends[index, 0]) @ (longest[1] - longest[0])) < 0.0
        made.append(_moved(wall, *(tips[::-1] if backwards else tips)))
    told = [f"walls {walls[i].name!r} and {walls[j].name!r} lie on one another: made one" for i, j in alike]
    return made, told


def _cut(wall: Wall, ends: Array, others: Array, names: set[str]) -> list[Wall]:
    """What is left of a wall beside others on its line; pieces after the first get names of their own."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    left = [(0.0, length)]
    for other in others:
        low, high = np.sort((other - ends[0]) @ along / length)
        left = [
            part
            for a, b in left
            for part in ((a, min(b, float(low))), (max(a, float(high)), b))
            if part[1] - part[0] > _SNAP_M
        ]
    pieces: list[Wall] = []
    for low, high in left:
        tips = [ends[0] + at / length * along for at in (low, high)]
        tips = [ends[0] if low == 0.0 else tips[0], ends[1] if high == length else tips[1]]
        name = wall.name
        number = 2
        while pieces and name in names:
            name, number = f"{wall.name[:90]}-{number}", number + 1
        names.add(name)
        pieces.append(_moved(wall, *tips, name=name))
    return pieces
