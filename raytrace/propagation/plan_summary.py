"""What a floor plan amounts to, and what is odd about it."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import shapely

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.space import SpaceConfig, confined, spaces
from raytrace.propagation.images import image_paths

__all__ = ["floorplan_summary"]

# Ends that meet, and ends that were probably drawn to meet.
_SNAP_M, _HAND_M = 1e-3, 0.1
# A space below this share of the plan is hardly the one that was meant.
_SMALL_SHARE = 0.1


def floorplan_summary(plan: FloorPlan) -> dict[str, Any]:
    """What a valid plan amounts to, and what is odd about it.

    Returns
    -------
    dict
        ``name``, ``walls``, ``wall_length_m``, ``materials`` (walls of each),
        ``area_m2`` (what the walls confine, doors bridged), ``space`` (that of the agent: ``kind``
        inside or outside, ``area_m2`` and its ``share``), ``repairs`` (what was changed in the walls
        on loading), ``anchors``, ``epochs``, ``track_m`` (length),
        ``line_of_sight`` (share of the epochs at which each anchor is seen),
        ``surfaces``, ``sha256`` and ``warnings`` (texts); ``agents`` (names) and ``targets`` if
        there are several, or any.
    """
    start, end = plan.walls_m()
    track = plan.track()
    seen = image_paths(plan, depth=0).valid[:, :, 0].mean(axis=0)
    names = [anchor.name for anchor in plan.anchors]
    place = _place(plan)
    lengths = np.linalg.norm(end - start, axis=1)
    return {
        "name": plan.name,
        "walls": len(plan.walls),
        "wall_length_m": round(float(lengths.sum()), 3),
        "materials": dict(Counter(wall.material for wall in plan.walls)),
        "area_m2": round(float(confined(start, end).area), 3),
        "space": place,
        "repairs": plan.repairs.lines(),
        "surfaces": len(plan.surface_names),
        "anchors": len(names),
        "line_of_sight": {n: round(float(share), 3) for n, share in zip(names, seen, strict=True)},
        "epochs": plan.agent.epochs,
        **({"agents": list(plan.by_agent())} if plan.agents else {}),
        **({"targets": len(plan.targets)} if plan.targets else {}),
        "track_m": round(float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum()), 3),
        "sha256": plan.sha256(),
        "warnings": [
            *_small(place),
            *_overlaps(plan),
            *_loose_ends(plan),
            *_unseen(names, seen),
            *_radio(plan),
        ],
    }


def _overlaps(plan: FloorPlan) -> list[str]:
    """Walls that lay on one another: resolved, but worth mending where they were drawn."""
    return [line.partition(":")[0] for line in plan.repairs.overlaps]


def _loose_ends(plan: FloorPlan) -> list[str]:
    """Ends that stop short of a wall by less than a hand's breadth: probably drawn to touch it."""
    ends = np.stack(plan.walls_m(), axis=1)
    lines, points = shapely.linestrings(ends), shapely.points(ends.reshape(-1, 2))
    point, wall = shapely.STRtree(lines).query(points, predicate="dwithin", distance=_HAND_M)
    gap = shapely.distance(points[point], lines[wall])
    gap[wall == point // 2] = np.inf
    found = []
    for index in np.unique(point):
        mine = np.flatnonzero(point == index)
        nearest = mine[np.argmin(gap[mine])]
        if _SNAP_M < gap[nearest] < _HAND_M:
            names = plan.walls[index // 2].name, plan.walls[wall[nearest]].name
            found.append(f"wall {names[0]!r} ends {gap[nearest]:.3g} m from {names[1]!r}")
    return found


def _place(plan: FloorPlan) -> dict[str, Any]:
    """The space in which the agent starts: inside or outside, its area and share of the plan."""
    start, end = plan.walls_m()
    thickness = np.array([wall.thickness_m for wall in plan.walls])
    first = shapely.Point(plan.track()[0, :2])
    found = spaces(start, end, thickness)
    near = [space for space in found if shapely.distance(space.free, first) < SpaceConfig().clearance_m]
    if not near:
        return {"kind": "narrow" if found else "none", "area_m2": 0.0, "share": 0.0}
    space = min(near, key=lambda space: float(shapely.distance(space.free, first)))
    return {"kind": space.kind, "area_m2": round(space.area_m2, 1), "share": round(space.share, 3)}


def _small(place: dict[str, Any]) -> list[str]:
    """A space that is next to nothing of its plan is a closet, a shaft or a cavity."""
    if place["share"] >= _SMALL_SHARE:
        return []
    area = f"{place['area_m2']:g} m2, {place['share']:.1%} of what the walls confine"
    return [f"the agent starts in a space of {area}: a closet, a shaft, or rooms without doors?"]


def _unseen(names: list[str], seen: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    return [
        f"anchor {name!r} is never in the agent's line of sight"
        for name, share in zip(names, seen, strict=True)
        if share == 0.0
    ]


def _radio(plan: FloorPlan) -> list[str]:
    """Clocks and speeds that make the channels ambiguous."""
    grid, found = plan.radio.grid(), []
    error_s = float(np.abs(plan.clock_errors_s()).max())
    unambiguous_s = 0.5 / grid.tone_spacing_hz
    if error_s > unambiguous_s:
        found.append(f"clocks differ by {error_s:.3g} s, delays are unambiguous within {unambiguous_s:.3g} s")
    doppler_hz = plan.agent.speed_m_s * grid.carrier_hz / SPEED_OF_LIGHT_M_S
    integrated_s = plan.radio.symbols / plan.radio.subcarrier_spacing_hz
    if doppler_hz * integrated_s > 0.25:
        found.append(
            f"at {plan.agent.speed_m_s:g} m/s a path turns by {doppler_hz * integrated_s:.2g} turns "
            f"within the {plan.radio.symbols} symbols that a channel integrates, as if it stood"
        )
    if doppler_hz * plan.radio.snapshot_interval_s > 0.5 and plan.radio.snapshots > 1:
        found.append(
            f"Doppler shifts up to {doppler_hz:.3g} Hz are ambiguous with snapshots "
            f"{plan.radio.snapshot_interval_s:g} s apart"
        )
    return found
