"""Whether a floor plan is possible: materials, walls, and who stands where.

The ray tracer is silent about nonsense (a transmitter inside a wall just has no
paths), so everything is checked before it is traced. Anchors, agents and targets may stand
anywhere off the walls: a plan need not enclose anything.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import shapely

from estimator.errors import InputError
from raytrace.plan.errors import PlanFault
from raytrace.plan.materials import ITU_MATERIALS

if TYPE_CHECKING:
    from raytrace.plan.floorplan import FloorPlan
    from raytrace.plan.targets import Target

__all__ = ["check_plan"]

_SNAP_M = 1e-3
# The radar equation and the spherical wave have no near field: nothing stands nearer to an antenna.
_NEAR_FIELD_M = 0.1


def check_plan(plan: FloorPlan) -> None:
    """Check a plan beyond the types of its values.

    Raises
    ------
    PlanFault
        For the first thing found wrong.
    """
    _check_names(plan)
    _check_engine(plan)
    _check_walls(plan)
    _check_materials(plan)
    lines = shapely.STRtree(shapely.linestrings(np.stack(plan.walls_m(), axis=1)))
    _check_anchors(plan, lines)
    _check_agent(plan, lines)
    _check_targets(plan, lines)
    for index, (name, alone) in enumerate(list(plan.by_agent().items())[1:]):
        try:
            _check_agent(alone, lines)
            _check_targets(alone, lines)
        except PlanFault as fault:
            raise PlanFault(f"agents[{index}] ({name}): {fault}") from fault


def _check_engine(plan: FloorPlan) -> None:
    if plan.tracing.engine == "images" and plan.scatters:
        raise PlanFault(
            'tracing.engine: expected "sionna" where materials scatter, got "images" '
            "(tracing.diffuse = false leaves scattering out)"
        )


def _check_names(plan: FloorPlan) -> None:
    for field, names in (
        ("walls", [wall.name for wall in plan.walls]),
        ("anchors", [anchor.name for anchor in plan.anchors]),
        ("targets", [target.name for target in plan.targets]),
        ("agents", ["agent", *(agent.name for agent in plan.agents)]),
    ):
        twice = _first_repeated(names)
        if twice is not None:
            raise PlanFault(f"{field}: expected names that differ, got {twice!r} twice")


def _first_repeated(names: Iterable[str]) -> str | None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def _check_walls(plan: FloorPlan) -> None:
    for index, wall in enumerate(plan.walls):
        if np.hypot(wall.to_m[0] - wall.from_m[0], wall.to_m[1] - wall.from_m[1]) < _SNAP_M:
            raise PlanFault(
                f"walls[{index}] ({wall.name}): expected two ends at least {_SNAP_M:g} m apart, "
                f"got a zero-length wall at {wall.from_m}"
            )


def _check_materials(plan: FloorPlan) -> None:
    for material in plan.materials:
        if material in ITU_MATERIALS:
            raise PlanFault(f"materials: expected names that are not of the ITU's table, got {material!r}")
    known = (*ITU_MATERIALS, *plan.materials)
    fields = [f"walls[{index}] ({wall.name})" for index, wall in enumerate(plan.walls)]
    for field, slab in zip([*fields, *plan.surface_names[len(fields) :]], plan.surface_slabs, strict=True):
        if slab.material not in known:
            raise PlanFault(f"{field}.material: expected one of {', '.join(known)}, got {slab.material!r}")
        for link, carrier_hz in (("radio", plan.radio.carrier_hz), ("echo", plan.echo.carrier_hz)):
            try:
                plan.permittivity_of(slab.material, carrier_hz)
            except InputError as error:
                raise PlanFault(f"{field}.material with {link}.carrier_hz: {error}") from error
    for field, materials in (
        ("scattering", plan.scattering),
        ("scattering_patterns", plan.scattering_patterns),
    ):
        for material in materials:
            if material not in known:
                raise PlanFault(f"{field}: expected names among {', '.join(known)}, got {material!r}")


def _struck(plan: FloorPlan, lines: shapely.STRtree, geometry: shapely.Geometry) -> list[tuple[int, float]]:
    """Walls within whose thickness a geometry lies, by their numbers, and its distance from their lines."""
    thickest = max(wall.thickness_m for wall in plan.walls)
    near = np.sort(lines.query(geometry, predicate="dwithin", distance=0.5 * thickest))
    gaps = shapely.distance(lines.geometries[near], geometry)
    return [
        (int(index), float(gap))
        for index, gap in zip(near, gaps, strict=True)
        if gap <= 0.5 * plan.walls[index].thickness_m
    ]


def _check_place(
    plan: FloorPlan, lines: shapely.STRtree, field: str, position_m: tuple[float, float, float]
) -> None:
    """Whether an anchor or a target stands under the ceiling and off the walls."""
    x, y, z = position_m
    if not 0.0 < z < plan.ceiling_height_m:
        raise PlanFault(f"{field}: expected a height between 0 and {plan.ceiling_height_m:g} m, got {z:g} m")
    for index, gap in _struck(plan, lines, shapely.Point(x, y)):
        wall = plan.walls[index]
        if z <= wall.height_m:
            raise PlanFault(
                f"{field}: expected a place more than {0.5 * wall.thickness_m:g} m from every wall's "
                f"centre line, got ({x:g}, {y:g}), {gap:.3g} m from wall {wall.name!r}: it is in the wall"
            )


def _check_anchors(plan: FloorPlan, lines: shapely.STRtree) -> None:
    for index, anchor in enumerate(plan.anchors):
        _check_place(plan, lines, f"anchors[{index}] ({anchor.name}).position_m", anchor.position_m)


def _check_agent(plan: FloorPlan, lines: shapely.STRtree) -> None:
    agent = plan.agent
    if agent.height_m >= plan.ceiling_height_m:
        raise PlanFault(
            f"agent.height_m: expected less than the ceiling's {plan.ceiling_height_m:g} m, "
            f"got {agent.height_m:g}"
        )
    for index, (before, after) in enumerate(zip(agent.waypoints_m, agent.waypoints_m[1:], strict=False)):
        if before == after:
            raise PlanFault(
                f"agent.waypoints_m[{index + 1}]: expected a point that differs, got {after} twice"
            )
    try:
        track = plan.track()
    except InputError as error:
        raise PlanFault(f"agent.{error}") from error
    beyond = [epoch for epoch in plan.sweep_epochs if epoch >= agent.epochs]
    if beyond:
        raise PlanFault(
            f"echo.sweep_epochs: expected epochs below agent.epochs = {agent.epochs}, got {beyond[0]}"
        )
    path = shapely.linestrings(track[:, :2]) if len(track) > 1 else shapely.Point(track[0, :2])
    for index, gap in _struck(plan, lines, path):
        wall = plan.walls[index]
        raise PlanFault(
            f"agent.waypoints_m: expected a track that stays more than {0.5 * wall.thickness_m:g} m from "
            f"every wall's centre line, got {gap:.3g} m from wall {wall.name!r}: the agent crosses the wall"
        )
    for index, anchor in enumerate(plan.anchors):
        gap = float(np.linalg.norm(track - np.array(anchor.position_m), axis=1).min())
        if gap < _NEAR_FIELD_M:
            raise PlanFault(
                f"anchors[{index}] ({anchor.name}).position_m: expected at least {_NEAR_FIELD_M:g} m to the "
                f"agent's track, got {gap:.3g} m"
            )


def _check_targets(plan: FloorPlan, lines: shapely.STRtree) -> None:
    """Whether targets are off the walls, their tracks cross none, and nobody walks into them."""
    track, times = plan.track(), plan.times_s()
    for index, target in enumerate(plan.targets):
        field = f"targets[{index}] ({target.name})"
        if target.position_m is not None:
            field = f"{field}.position_m"
            _check_place(plan, lines, field, target.position_m)
        else:
            field = f"{field}.waypoints_m"
            _check_way(plan, lines, field, target)
        places = target.motion(times).place_m
        if target.body_m is None:
            gap = float(np.linalg.norm(track - places, axis=1).min())
            room = _NEAR_FIELD_M
        else:
            length, width, height = target.body_m
            gap = float(np.linalg.norm((track - places)[:, :2], axis=1).min())
            room = _NEAR_FIELD_M + 0.5 * float(np.hypot(length, width))
            for anchor in plan.anchors:
                apart = float(np.linalg.norm(places[:, :2] - anchor.position_m[:2], axis=1).min())
                if anchor.position_m[2] < height and apart < room:
                    who = f"anchor {anchor.name!r}"
                    raise PlanFault(f"{field}: expected at least {room:.3g} m to {who}, got {apart:.3g} m")
        if gap < room:
            raise PlanFault(f"{field}: expected at least {room:.3g} m to the agent's track, got {gap:.3g} m")


def _check_way(plan: FloorPlan, lines: shapely.STRtree, field: str, target: Target) -> None:
    """Whether the way of a target is below the ceiling and crosses no wall."""
    top = target.height_m if target.body_m is None else target.body_m[2]
    if top >= plan.ceiling_height_m:
        raise PlanFault(
            f"{field}: expected less than the ceiling's {plan.ceiling_height_m:g} m, got {top:g} m"
        )
    points = target.waypoints_m
    for index, gap in _struck(
        plan, lines, shapely.LineString(points) if points[1:] else shapely.Point(points)
    ):
        wall = plan.walls[index]
        raise PlanFault(
            f"{field}: expected a way that stays more than {0.5 * wall.thickness_m:g} m from every wall's "
            f"centre line, got {gap:.3g} m from wall {wall.name!r}"
        )
