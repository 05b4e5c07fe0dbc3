"""What a floor plan amounts to, and what is odd about it."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import shapely

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.placement import enclosed
from raytrace.propagation.images import image_paths

__all__ = ["floorplan_summary"]

_SNAP_M = 1e-3


def floorplan_summary(plan: FloorPlan) -> dict[str, Any]:
    """What a valid plan amounts to, and what is odd about it.

    Returns
    -------
    dict
        ``name``, ``walls``, ``wall_length_m``, ``materials`` (walls of each),
        ``area_m2``, ``anchors``, ``epochs``, ``track_m`` (length),
        ``line_of_sight`` (share of the epochs at which each anchor is seen),
        ``surfaces``, ``sha256`` and ``warnings`` (texts); ``agents`` (names) and ``targets`` if
        there are several, or any.
    """
    start, end = plan.walls_m()
    track = plan.track()
    seen = image_paths(plan, depth=0).valid[:, :, 0].mean(axis=0)
    names = [anchor.name for anchor in plan.anchors]
    room = enclosed(start, end)
    lengths = np.linalg.norm(end - start, axis=1)
    return {
        "name": plan.name,
        "walls": len(plan.walls),
        "wall_length_m": round(float(lengths.sum()), 3),
        "materials": dict(Counter(wall.material for wall in plan.walls)),
        "area_m2": round(float(room.area), 3),
        "surfaces": len(plan.surface_names),
        "anchors": len(names),
        "line_of_sight": {n: round(float(share), 3) for n, share in zip(names, seen, strict=True)},
        "epochs": plan.agent.epochs,
        **({"agents": list(plan.by_agent())} if plan.agents else {}),
        **({"targets": len(plan.targets)} if plan.targets else {}),
        "track_m": round(float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum()), 3),
        "sha256": plan.sha256(),
        "warnings": [*_overlaps(plan), *_loose_ends(plan), *_unseen(names, seen), *_radio(plan)],
    }


def _overlaps(plan: FloorPlan) -> list[str]:
    """Walls that lie on one another: which of them a ray meets is left to chance."""
    start, end = plan.walls_m()
    lines = shapely.linestrings(np.stack([start, end], axis=1))
    tree = shapely.STRtree(lines)
    found = []
    for one, other in tree.query(lines, predicate="dwithin", distance=_SNAP_M).T:
        if one < other:
            shared = shapely.intersection(shapely.buffer(lines[one], _SNAP_M, cap_style="flat"), lines[other])
            if shapely.length(shared) > 10 * _SNAP_M:
                names = plan.walls[one].name, plan.walls[other].name
                found.append(f"walls {names[0]!r} and {names[1]!r} lie on one another")
    return found


def _loose_ends(plan: FloorPlan) -> list[str]:
    """Ends that stop short of a wall by less than a hand's breadth: probably drawn to touch it."""
    start, end = plan.walls_m()
    lines = shapely.linestrings(np.stack([start, end], axis=1))
    found = []
    for index, wall in enumerate(plan.walls):
        for x, y in (wall.from_m, wall.to_m):
            distance = shapely.distance(shapely.Point(x, y), lines)
            distance[index] = np.inf
            nearest = int(np.argmin(distance))
            if _SNAP_M < distance[nearest] < 0.1:
                found.append(
                    f"wall {wall.name!r} ends {distance[nearest]:.3g} m from {plan.walls[nearest].name!r}"
                )
    return found


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
