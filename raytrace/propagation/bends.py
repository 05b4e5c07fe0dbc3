"""Paths that bend once, by geometry: straight through one wall, and around one upright corner.

A line of sight that passes exactly one surface is a path through it. A corner is where a wall ends and
another of its material, thickness and height begins; its *wedge* is the part of the plan between the two,
and rays go around it from outside. On the upright edge the path's point is Keller's: at both sides of it
the ray makes the same angle with the edge, so that seen from above and unrolled it is straight,

    z = z_s + (z_t - z_s) rho_s / (rho_s + rho_t),

``rho`` the level distances. Corners where more than two such walls meet have no wedge that
could be told, and are left out. As for specular paths, what a rim decides is neither owed nor wrong.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.obstacles import blocked
from raytrace.propagation.paths import REFRACTION, PathList
from raytrace.propagation.reflectors import RIM_M, Surfaces, surfaces_of

__all__ = ["BentOnce", "Corners", "Matched", "bent_once", "corners_of", "match_bends", "names_of_bends"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Ends of walls nearer than this are one corner, metres: loading a plan makes them meet.
_MEET_M = 1e-6
# Walls that turn by less go straight on, radians.
_FLATTEST_RAD = 1e-3
# So far outside of its corner a leg ends, metres, as in the ray tracer; and so near a face's plane the
# side on which an end stands is not decided.
_OUTSIDE_M = 1e-3
# Nearer to its corner the rims of the faces are not asked whether they hide a leg, metres: a leg that
# grazes a face by more than a degree is a millimetre off there.
_NEAR_CORNER_M = 0.05
# A traced path is one around a corner if it is as long to within this, metres: single precision.
_SAME_LENGTH_M = 5e-3


@dataclass(frozen=True, eq=False)
class Corners:
    """Upright edges that rays go around.

    Parameters
    ----------
    place_m : ndarray, shape (n, 2)
        Where, metres.
    height_m : ndarray, shape (n,)
        How high, metres.
    faces : ndarray of int64, shape (n, 2)
        The wall that ends there and the wall that begins.
    normals : ndarray, shape (n, 2, 2)
        Unit normals of both, out of the wedge.
    doubtful_m : ndarray, shape (m, 2)
        Corners of more walls, metres.
    """

    place_m: Array
    height_m: Array
    faces: Indices
    normals: Array
    doubtful_m: Array


@dataclass(frozen=True, eq=False)
class BentOnce:
    """Paths that bend once.

    Parameters
    ----------
    epoch, anchor : ndarray of int64, shape (n,)
        Position and anchor that they join.
    name : ndarray of int64, shape (n,)
        The surface that they pass or, from the number of surfaces on, the corner that they go around.
    owed : ndarray of bool, shape (n,)
        Whether they are there whatever a rim decides.
    delay_s : ndarray, shape (n,)
        Time of flight, seconds.
    towards : ndarray, shape (n, 3)
        Unit vectors to where they come from.
    """

    epoch: Indices
    anchor: Indices
    name: Indices
    owed: NDArray[np.bool_]
    delay_s: Array
    towards: Array

    def __len__(self) -> int:
        return int(self.delay_s.size)


@dataclass(frozen=True, eq=False)
class Matched:
    """Traced paths beside those of the geometry.

    Parameters
    ----------
    paths : ndarray of int64, shape (n,)
        Traced paths that bend once and are known.
    known : ndarray of int64, shape (n,)
        Their rows of ``BentOnce``.
    missing : ndarray of int64, shape (m,)
        Rows of ``BentOnce`` that are owed and were not traced.
    extra : ndarray of int64, shape (k,)
        Traced paths that bend once, which no geometry explains.
    """

    paths: Indices
    known: Indices
    missing: Indices
    extra: Indices


def match_bends(plan: FloorPlan, positions_m: Array, paths: PathList, known: BentOnce) -> Matched:
    """Look for the paths that bend once among those of the geometry, and the other way round.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.
    paths : PathList
        Traced paths, of which those that bend once are looked at.
    known : BentOnce
        What :func:`bent_once` gives.
    """
    once = np.flatnonzero((paths.order == 1) & ~paths.is_specular)
    name, doubtful = names_of_bends(plan, paths.select(once), positions_m)
    bends = len(plan.surface_names) + 2 * len(plan.walls) + 1  # more than there are surfaces and corners
    keys = (paths.epoch[once] * len(plan.anchors) + paths.anchor[once]) * bends + name
    all_keys = (known.epoch * len(plan.anchors) + known.anchor) * bends + known.name
    named = np.flatnonzero(name >= 0)
    _, first = np.unique(keys[named], return_index=True)
    first = named[first]
    _, mine, theirs = np.intersect1d(keys[first], all_keys, return_indices=True)
    explained = np.zeros(len(once), dtype=np.bool_)
    explained[first[mine]] = True
    return Matched(
        paths=once[first[mine]],
        known=theirs,
        missing=np.flatnonzero(known.owed & ~np.isin(all_keys, keys[named])),
        extra=once[~explained & ~doubtful],
    )


def corners_of(plan: FloorPlan) -> Corners:
    """The corners of a plan's walls."""
    ends: dict[tuple[int, int], list[tuple[int, bool]]] = defaultdict(list)
    start, stop = plan.walls_m()
    for index in range(len(plan.walls)):
        for point, begins in ((start[index], True), (stop[index], False)):
            x, y = np.round(point / _MEET_M).astype(np.int64)
            ends[int(x), int(y)].append((index, begins))
    way = (stop - start) / np.linalg.norm(stop - start, axis=1)[:, None]
    places, heights, faces, normals, doubtful = [], [], [], [], []
    for there in ends.values():
        alike: dict[tuple[str, float, float], list[tuple[int, bool]]] = defaultdict(list)
        for index, begins in there:
            wall = plan.walls[index]
            alike[wall.material, wall.thickness_m, wall.height_m].append((index, begins))
        for members in alike.values():
            place = start[members[0][0]] if members[0][1] else stop[members[0][0]]
            if len(members) > 2:
                doubtful.append(place)
            if len(members) != 2 or members[0][1] == members[1][1]:
                continue
            (before, _), (after, _) = sorted(members, key=lambda member: member[1])
            inward = np.array([-way[before], way[after]])  # from the corner along either wall
            if abs(inward[0, 0] * inward[1, 1] - inward[0, 1] * inward[1, 0]) < _FLATTEST_RAD:
                continue
            normal = np.stack([-inward[:, 1], inward[:, 0]], axis=1)
            out = np.where(np.sum(normal * inward[::-1], axis=1) > 0.0, -1.0, 1.0)
            places.append(place)
            heights.append(plan.walls[before].height_m)
            faces.append((before, after))
            normals.append(normal * out[:, None])
    return Corners(
        np.array(places).reshape(-1, 2),
        np.array(heights),
        np.array(faces, dtype=np.int64).reshape(-1, 2),
        np.array(normals).reshape(-1, 2, 2),
        np.array(doubtful).reshape(-1, 2),
    )


def bent_once(plan: FloorPlan, positions_m: Array, rim_m: float) -> BentOnce:
    """All paths that bend once from every anchor to every position.

    Parameters
    ----------
    plan : FloorPlan
        ``tracing`` says whether paths go through walls, and around corners.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.
    rim_m : float
        What passes the rim of a surface as near as this may be there or not, metres.
    """
    surfaces = surfaces_of(plan)
    parts = []
    for index, anchor in enumerate(plan.anchors_m()):
        if plan.tracing.refraction:
            parts.append(_through(surfaces, index, anchor, positions_m, rim_m))
        if plan.tracing.diffraction:
            corners = corners_of(plan)
            parts += [
                _around(surfaces, corners, corner, index, anchor, positions_m, rim_m)
                for corner in range(len(corners.place_m))
            ]
    nothing = np.empty(0, dtype=np.int64)
    parts.append(BentOnce(nothing, nothing, nothing, nothing.astype(bool), np.empty(0), np.empty((0, 3))))
    columns = ("epoch", "anchor", "name", "owed", "delay_s", "towards")
    return BentOnce(*(np.concatenate([getattr(part, column) for part in parts]) for column in columns))


def names_of_bends(plan: FloorPlan, paths: PathList, positions_m: Array) -> tuple[Indices, NDArray[np.bool_]]:
    """``BentOnce.name`` of traced paths that bend once; -1 where it is at no corner that is known.

    Returns
    -------
    name : ndarray of int64, shape (n,)
    doubtful : ndarray of bool, shape (n,)
        Whether a corner of more than two walls, a free end or a rim may be what it goes around.
    """
    count = len(plan.surface_names)
    through = paths.interactions[:, 0] == REFRACTION
    wall = paths.walls[:, 0].astype(np.int64)
    name = np.where(through, wall, -1)
    corners = corners_of(plan)
    source, agent = plan.anchors_m()[paths.anchor], positions_m[paths.epoch]
    length = paths.delay_s * SPEED_OF_LIGHT_M_S
    best = np.full(len(paths), _SAME_LENGTH_M)
    for corner, place in enumerate(corners.place_m):
        gap = np.abs(_length_around(source, agent, place) - length)
        mine = ~through & np.isin(wall, corners.faces[corner]) & (gap < best)
        name[mine], best[mine] = count + corner, gap[mine]
    doubtful = np.full(len(paths), plan.tracing.edge_diffraction)
    for place in corners.doubtful_m:
        doubtful |= np.abs(_length_around(source, agent, place) - length) < _SAME_LENGTH_M
    return name, doubtful & ~through & (name < 0)


def _length_around(source: Array, agent: Array, place: Array) -> Array:
    """Length of paths from (n, 3) to (n, 3) around an upright edge, metres."""
    level = np.linalg.norm(source[:, :2] - place, axis=1) + np.linalg.norm(agent[:, :2] - place, axis=1)
    return np.asarray(np.hypot(level, agent[:, 2] - source[:, 2]))


def _through(surfaces: Surfaces, index: int, anchor: Array, positions: Array, rim_m: float) -> BentOnce:
    """Lines of sight that pass exactly one surface."""
    count = len(positions)
    starts = np.broadcast_to(anchor, positions.shape)
    surely, maybe = (_passed(surfaces, starts, positions, margin) for margin in (-rim_m, rim_m))
    # A surface that is passed or not as its rim decides makes every count doubtful.
    one = np.array([len(some) == 1 for some in surely]) | np.array([len(some) == 1 for some in maybe])
    owed = np.array([a == b and len(a) == 1 for a, b in zip(surely, maybe, strict=True)], dtype=bool)
    rows, names, sure = [], [], []
    for row in np.flatnonzero(one):
        for surface in surely[row] | maybe[row]:
            rows.append(row)
            names.append(surface)
            sure.append(bool(owed[row]))
    epoch = np.array(rows, dtype=np.int64)
    away = starts[epoch] - positions[epoch] if count else np.empty((0, 3))
    length = np.linalg.norm(away, axis=1)
    return BentOnce(
        epoch,
        np.full(len(epoch), index, dtype=np.int64),
        np.array(names, dtype=np.int64),
        np.array(sure, dtype=bool),
        length / SPEED_OF_LIGHT_M_S,
        away / np.maximum(length, _OUTSIDE_M)[:, None],
    )


def _passed(surfaces: Surfaces, start: Array, end: Array, margin_m: float) -> list[frozenset[int]]:
    """Surfaces, grown by a margin, that each leg passes."""
    passed: list[set[int]] = [set() for _ in start]
    for surface in range(len(surfaces)):
        normal, origin = surfaces.normal[surface], surfaces.origin[surface]
        before, after = (start - origin) @ normal, (end - origin) @ normal
        across = before - after
        with np.errstate(divide="ignore", invalid="ignore"):
            share = before / across
            stretch = np.linalg.norm(end - start, axis=1) / np.abs(across)
        point = start + np.where(np.isfinite(share), share, 0.0)[:, None] * (end - start) - origin
        along = point @ surfaces.sides[surface].T
        margin = (margin_m * np.where(np.isfinite(stretch), stretch, 0.0))[:, None]
        within = np.all((along > -margin) & (along < surfaces.lengths[surface] + margin), axis=1)
        for row in np.flatnonzero(within & (before * after < 0.0)):
            passed[row].add(surface)
    return [frozenset(some) for some in passed]


def _around(
    surfaces: Surfaces,
    corners: Corners,
    corner: int,
    index: int,
    anchor: Array,
    positions: Array,
    rim_m: float,
) -> BentOnce:
    """Paths around one corner to every position."""
    place, normals, height = corners.place_m[corner], corners.normals[corner], corners.height_m[corner]
    starts = np.broadcast_to(anchor, positions.shape)
    sides = [(ends[:, :2] - place) @ normals.T for ends in (starts, positions)]  # (n, faces)
    rho = [np.linalg.norm(ends[:, :2] - place, axis=1) for ends in (starts, positions)]
    share = rho[0] / (rho[0] + rho[1])
    level = anchor[2] + (positions[:, 2] - anchor[2]) * share
    point = np.column_stack([np.tile(place, (len(positions), 1)), level])
    out = normals.sum(axis=0)
    outside = point + _OUTSIDE_M * np.append(out / np.linalg.norm(out), 0.0)
    found = {}
    for owed, margin in ((True, rim_m), (False, -rim_m)):
        there = (level > margin) & (level < height - margin)
        for side in sides:
            there &= np.any(side > margin, axis=1)
        rows = np.flatnonzero(there)
        for ends in (starts, positions):
            rows = rows[~blocked(surfaces, ends[rows], outside[rows], RIM_M if owed else -rim_m)]
            if owed:  # the corner's own rims are no obstacle; others are
                back = ends[rows] - outside[rows]
                back *= _NEAR_CORNER_M / np.maximum(np.linalg.norm(back, axis=1), _NEAR_CORNER_M)[:, None]
                rows = rows[~blocked(surfaces, ends[rows], outside[rows] + back, rim_m)]
        found[owed] = rows
    rows = found[False]
    away = point[rows] - positions[rows]
    return BentOnce(
        rows,
        np.full(len(rows), index, dtype=np.int64),
        np.full(len(rows), len(surfaces) + corner, dtype=np.int64),
        np.isin(rows, found[True]),
        _length_around(starts[rows], positions[rows], place) / SPEED_OF_LIGHT_M_S,
        away / np.linalg.norm(away, axis=1, keepdims=True),
    )
