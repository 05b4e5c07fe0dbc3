"""Whether a floor plan is possible: materials, walls, and who stands where.

The ray tracer is silent about nonsense (a transmitter inside a wall just has no
paths), so everything is checked before it is traced.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import shapely

from estimator.errors import InputError
from raytrace.plan.materials import ITU_MATERIALS

if TYPE_CHECKING:
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["PlanFault", "check_plan"]

_SNAP_M = 1e-3


class PlanFault(InputError):
    """What is wrong with a plan: the field, what was expected, what came."""


def check_plan(plan: FloorPlan) -> None:
    """Check a plan beyond the types of its values.

    Raises
    ------
    PlanFault
        For the first thing found wrong.
    """
    _check_names(plan)
    _check_walls(plan)
    _check_materials(plan)
    room = _room(plan)
    _check_anchors(plan, room)
    _check_agent(plan, room)
    _check_targets(plan, room)
    for index, (name, alone) in enumerate(list(plan.by_agent().items())[1:]):
        try:
            _check_agent(alone, room)
            _check_targets(alone, room)
        except PlanFault as fault:
            raise PlanFault(f"agents[{index}] ({name}): {fault}") from fault


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


def _room(plan: FloorPlan) -> shapely.Geometry:
    """The area that the walls enclose; corners that meet within a millimetre are closed."""
    lines = shapely.linestrings([(wall.from_m, wall.to_m) for wall in plan.walls])
    network = shapely.union_all(shapely.set_precision(lines, _SNAP_M))
    return shapely.union_all(shapely.get_parts(shapely.polygonize([*shapely.get_parts(network)])))


def _check_anchors(plan: FloorPlan, room: shapely.Geometry) -> None:
    for index, anchor in enumerate(plan.anchors):
        field = f"anchors[{index}] ({anchor.name}).position_m"
        x, y, z = anchor.position_m
        if not 0.0 < z < plan.ceiling_height_m:
            raise PlanFault(
                f"{field}: expected a height between 0 and {plan.ceiling_height_m:g} m, got {z:g} m"
            )
        point = shapely.Point(x, y)
        for wall in plan.walls:
            distance = shapely.distance(point, shapely.linestrings([wall.from_m, wall.to_m]))
            if z <= wall.height_m and distance <= 0.5 * wall.thickness_m:
                raise PlanFault(
                    f"{field}: expected a place more than {0.5 * wall.thickness_m:g} m from every wall's "
                    f"centre line, got ({x:g}, {y:g}), {distance:.3g} m from wall {wall.name!r}: "
                    "it is in the wall"
                )
        if not shapely.contains(room, point):
            raise PlanFault(
                f"{field}: expected a place inside the room (enclosed by walls), got ({x:g}, {y:g})"
            )


def _check_agent(plan: FloorPlan, room: shapely.Geometry) -> None:
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
    beyond = [epoch for epoch in plan.echo.sweep_epochs if epoch >= agent.epochs]
    if beyond:
        raise PlanFault(
            f"echo.sweep_epochs: expected epochs below agent.epochs = {agent.epochs}, got {beyond[0]}"
        )
    points = shapely.points(track[:, :2])
    inside = shapely.contains(room, points)
    if not inside.all():
        epoch = int(np.argmin(inside))
        x, y, _ = track[epoch]
        verb = "starts outside" if epoch == 0 else "leaves"
        raise PlanFault(
            f"agent.waypoints_m: expected a track inside the room (enclosed by walls), "
            f"got ({x:.2f}, {y:.2f}) at epoch {epoch}: the agent {verb} the room"
        )
    path = shapely.linestrings(track[:, :2]) if len(track) > 1 else points[0]
    for wall in plan.walls:
        distance = shapely.distance(path, shapely.linestrings([wall.from_m, wall.to_m]))
        if distance <= 0.5 * wall.thickness_m:
            raise PlanFault(
                f"agent.waypoints_m: expected a track that stays more than {0.5 * wall.thickness_m:g} m from "
                f"every wall's centre line, got {distance:.3g} m from wall {wall.name!r}: "
                "the agent crosses the wall"
            )
    for index, anchor in enumerate(plan.anchors):
        gap = float(np.linalg.norm(track - np.array(anchor.position_m), axis=1).min())
        if gap < 0.1:
            raise PlanFault(
                f"anchors[{index}] ({anchor.name}).position_m: expected at least 0.1 m to the agent's track, "
                f"got {gap:.3g} m"
            )


def _check_targets(plan: FloorPlan, room: shapely.Geometry) -> None:
    """Targets are inside the room and off the agent's track: the radar equation has no near field."""
    track = plan.track()
    for index, target in enumerate(plan.targets):
        field = f"targets[{index}] ({target.name}).position_m"
        x, y, z = target.position_m
        if not 0.0 < z < plan.ceiling_height_m:
            raise PlanFault(
                f"{field}: expected a height between 0 and {plan.ceiling_height_m:g} m, got {z:g} m"
            )
        if not shapely.contains(room, shapely.Point(x, y)):
            raise PlanFault(
                f"{field}: expected a place inside the room (enclosed by walls), got ({x:g}, {y:g})"
            )
        gap = float(np.linalg.norm(track - np.array(target.position_m), axis=1).min())
        if gap < 0.1:
            raise PlanFault(f"{field}: expected at least 0.1 m to the agent's track, got {gap:.3g} m")
