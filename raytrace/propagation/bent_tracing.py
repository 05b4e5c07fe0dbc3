"""Paths through walls and around corners: traced, and complete as far as they bend once.

What bends once is known by geometry (:mod:`raytrace.propagation.bends`). The tracer meets a corner only if
a ray hits a wall beside it, and of narrow walls, or walls of which little shows, none may. So where a path
is missing after the plan's rays and four times as many, the walls of its corner are traced alone, and large:
how a path bends depends on nothing but the edge and the planes of its faces. Delays and directions of
arrival are then those of the geometry, in double precision. Of paths that bend more often, or bounce
besides, nothing tells whether one was lost in a hash collision; every position is traced twice, in
batches that differ.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bends import BentOnce, Matched, bent_once, corners_of, match_bends, names_of_bends
from raytrace.propagation.directions import angles_of
from raytrace.propagation.passive import RIM_M, TraceReport, distinct_paths, trace_batches
from raytrace.propagation.paths import NO_SURFACE, PathList
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.propagation.solver import Bends

__all__ = ["trace_bent"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SAME_M = 1e-3  # an end of a wall nearer to a corner is there
_WIDTH_ALONE = 64  # positions of a batch where the walls of one corner are traced


def trace_bent(plan: FloorPlan, radio: RadioScene, positions_m: Array) -> tuple[PathList, TraceReport]:
    """Paths through walls and around corners, as ``plan.tracing`` asks, from every anchor.

    Parameters
    ----------
    plan, radio
        As for :func:`raytrace.propagation.passive.trace_passive`.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.

    Returns
    -------
    paths : PathList
        Paths with at least one refraction or diffraction; ``epoch`` counts the positions.
    report : TraceReport
        How those that bend once compare with the geometry; ``retraced`` counts paths that were missing
        at first.
    """
    tracing = plan.tracing
    bends = Bends(tracing.refraction, tracing.diffraction, tracing.edge_diffraction)
    everywhere = np.arange(len(positions_m))
    parts = [
        trace_batches(
            radio,
            source,
            index,
            positions_m,
            epochs,
            samples,
            depth=tracing.depth,
            polarised=plan.polarised,
            bends=bends,
        )
        for index, source in enumerate(plan.anchors_m())
        for epochs, samples in ((everywhere, tracing.samples), (np.roll(everywhere, 97), 4 * tracing.samples))
    ]
    paths = PathList.concatenate(parts)
    paths = distinct_paths(paths.select(~paths.is_specular))
    known = bent_once(plan, positions_m, RIM_M)
    missing = match_bends(plan, positions_m, paths, known).missing
    again = _alone(plan, radio.carrier_hz, positions_m, known, missing, paths.walls.shape[1])
    paths = distinct_paths(PathList.concatenate([paths, *again]))
    found = match_bends(plan, positions_m, paths, known)
    paths = paths.select(np.setdiff1d(np.arange(len(paths)), found.extra))
    found = match_bends(plan, positions_m, paths, known)
    report = TraceReport(
        expected=len(found.paths) + len(found.missing),
        found=len(found.paths),
        missing=len(found.missing),
        extra=0,
        retraced=len(missing),
    )
    return _sharpened(paths, found, known, radio.carrier_hz), report


def _alone(
    plan: FloorPlan, carrier_hz: float, positions: Array, known: BentOnce, missing: Indices, width: int
) -> list[PathList]:
    """Missing paths, traced where nothing but the walls at which they bend stands."""
    surfaces, corners, parts = len(plan.surface_names), corners_of(plan), []
    for name in np.unique(known.name[missing]):
        around = bool(name >= surfaces)
        walls = corners.faces[name - surfaces] if around else np.array([name])
        if walls.max() >= len(plan.walls):
            continue  # a floor or a ceiling, which is nothing without walls
        radio = build_scene(
            _grown(plan, walls, corners.place_m[name - surfaces] if around else None), carrier_hz
        )
        for anchor in np.unique(known.anchor[missing[known.name[missing] == name]]):
            rows = missing[(known.name[missing] == name) & (known.anchor[missing] == anchor)]
            traced = trace_batches(
                radio,
                plan.anchors_m()[anchor],
                int(anchor),
                positions,
                known.epoch[rows],
                plan.tracing.samples,
                depth=1,
                polarised=plan.polarised,
                bends=Bends(not around, around, False),
                width=_WIDTH_ALONE,
            )
            traced = traced.select(~traced.is_specular & (traced.order == 1))
            named = np.full((len(traced), width), NO_SURFACE, dtype=np.int16)
            named[:, 0] = walls[traced.walls[:, 0]]
            kinds = np.zeros(named.shape, dtype=np.int8)
            kinds[:, 0] = traced.interactions[:, 0]
            traced = replace(traced, walls=named, interactions=kinds)
            there, _ = names_of_bends(plan, traced, positions)
            parts.append(traced.select(there == name))
    return parts


def _grown(plan: FloorPlan, walls: Indices, corner: Array | None) -> FloorPlan:
    """The plan with some of its walls alone, so large that rays cannot but meet them.

    They grow away from the corner, or both ways if there is none: a ray sees no more of a wedge than its
    edge and the planes of its faces.
    """
    ends = np.vstack(plan.walls_m())
    reach = float(np.linalg.norm(np.ptp(ends, axis=0)))
    grown = []
    for index in walls:
        wall = plan.walls[index]
        points = np.array([wall.from_m, wall.to_m])
        along = reach * (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        free = [True, True] if corner is None else list(np.linalg.norm(points - corner, axis=1) > _SAME_M)
        (x0, y0), (x1, y1) = points[0] - free[0] * along, points[1] + free[1] * along
        changes = {"from_m": (x0, y0), "to_m": (x1, y1), "height_m": wall.height_m + reach}
        grown.append(wall.model_copy(update=changes))
    return plan.model_copy(update={"walls": tuple(grown), "floor": None, "ceiling": None})


def _sharpened(paths: PathList, found: Matched, known: BentOnce, carrier_hz: float) -> PathList:
    """Paths with delays and directions of the geometry where it knows them."""
    delay, amplitude, transfer = paths.delay_s.copy(), paths.amplitude.copy(), paths.transfer.copy()
    azimuth, elevation = paths.arrival_azimuth_rad.copy(), paths.arrival_elevation_rad.copy()
    rows, exact = found.paths, found.known
    turn = np.exp(-2j * np.pi * carrier_hz * (known.delay_s[exact] - delay[rows]))
    amplitude[rows] *= turn
    transfer[rows] *= turn[:, None, None]
    delay[rows] = known.delay_s[exact]
    azimuth[rows], elevation[rows] = angles_of(known.towards[exact])
    return replace(
        paths,
        delay_s=delay,
        amplitude=amplitude,
        transfer=transfer,
        arrival_azimuth_rad=azimuth,
        arrival_elevation_rad=elevation,
    )
