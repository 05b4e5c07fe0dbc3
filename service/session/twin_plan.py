"""An estimated map as a floor plan: names, heights, materials, and how sure all of it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError

if TYPE_CHECKING:
    from estimator.measurements import MeasurementSet
    from estimator.result import SlamResult
    from estimator.twin.build import TwinMap
    from estimator.twin.stretches import Stretch
    from raytrace.plan.floorplan import FloorPlan
    from raytrace.plan.links import Radio
    from raytrace.prediction.wall_parts import WallPart
    from raytrace.propagation.slab_fit import SlabFit

__all__ = ["parts_of", "refined", "twin_of", "twin_plan"]

Array = NDArray[np.float64]
_HEADROOM_M = 0.5  # walls are higher than the highest anchor by this, and 3 m at least
_LEAST_HEIGHT_M = 3.0
_ASSUMED_MATERIAL, _ASSUMED_THICKNESS_M = "concrete", 0.2
_RESOLVED, _RESIDUAL_DB = 20, 0.15  # clean bounces, and their fit, that tell a material by themselves
_LEAST_TOLD = 5e-5  # probability of a material worth a line


def parts_of(twin: TwinMap) -> list[list[WallPart]]:
    """Each wall cut where its material changes; of walls that nobody heard, one part without a fit."""
    from raytrace.prediction.wall_parts import Losses, WallPart, wall_parts

    bounces, parts = twin.bounces, []
    for wall in twin.walls:
        if wall.line < 0:
            parts.append([WallPart(0.0, wall.length_m, None)])
            continue
        mine = bounces.wall == wall.line
        direction = (wall.ends_m[1] - wall.ends_m[0]) / wall.length_m
        along = (bounces.vertex_m[mine, 1, :2] - wall.ends_m[0]) @ direction
        losses = Losses(along, bounces.vertex_m[mine], bounces.loss_db[mine], bounces.noise_db[mine])
        parts.append(wall_parts(wall.length_m, wall.cuts_m, losses, twin.carrier_hz))
    return parts


def refined(plan: FloorPlan, twin: TwinMap, measured: MeasurementSet) -> FloorPlan:
    """The plan with the materials of walls whose reflections are not resolved told from clusters of paths."""
    from raytrace.plan.files import parse_floorplan
    from raytrace.prediction.material_refinement import clusters_of, refine_materials

    known = plan.uncertainty
    assert known is not None  # a twin states it
    told = {entry.wall: entry for entry in known.walls}
    free = [wall.name for wall in plan.walls if wall.name in told and not told[wall.name].resolved]
    columns = [measured.anchors.index(anchor.name) for anchor in plan.anchors]
    heard = [[epoch.paths[k] for k in columns] for epoch in measured.epochs]
    if not free or any(p.gain_db is None and len(p) for row in heard for p in row):
        return plan
    places = np.column_stack([twin.track_m, np.full(len(twin.track_m), plan.agent.height_m)])
    gains = [[np.zeros(0) if p.gain_db is None else p.gain_db for p in row] for row in heard]
    clusters = clusters_of(plan, places, [[p.range_m for p in row] for row in heard], gains)
    fits = refine_materials(plan, clusters, free)
    data = plan.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    for wall, full in zip(data["walls"], plan.walls, strict=True):
        wall.update(height_m=full.height_m, material=full.material, thickness_m=full.thickness_m)
        if full.name in fits:
            wall["material"], wall["thickness_m"] = fits[full.name][:2]
    for entry in data["uncertainty"]["walls"]:
        if entry["wall"] in fits:
            entry["material_probabilities"] = _likely(fits[entry["wall"]][2])
    return parse_floorplan({"format": plan.format, "version": plan.version, **data}, source=plan.name)


def twin_of(found: SlamResult, measured: MeasurementSet, name: str, agent_height_m: float = 1.5) -> FloorPlan:
    """The twin that a smoothed result and its measurements make.

    Parameters
    ----------
    found : SlamResult
        Result with its joint map.
    measured : MeasurementSet
        What it was made of.
    name : str
        Of the plan.
    agent_height_m : float
        Height of the agent over the floor, metres: nothing tells it.

    Raises
    ------
    InputError
        If nothing can be made of them: no wall, or no anchor.
    """
    from estimator.twin.build import build_twin

    built = build_twin(found, measured)
    return refined(twin_plan(built, name, _passive_link(measured), agent_height_m), built, measured)


def _passive_link(measured: MeasurementSet) -> Radio:
    """The passive link that measurements name; the default at their carrier where they name none."""
    from raytrace.plan.links import Radio

    stated = measured.settings.get("radio")
    fields = {"carrier_hz": measured.carrier_hz}
    if isinstance(stated, dict):
        known = ("subcarrier_spacing_hz", "subcarriers", "comb", "symbols", "eirp_dbm", "noise_figure_db")
        fields |= {name: stated[name] for name in known if name in stated}
    return Radio.model_validate(fields)


def twin_plan(twin: TwinMap, name: str, radio: Radio, agent_height_m: float = 1.5) -> FloorPlan:
    """Write a map down as a plan, in the estimator's frame.

    Parameters
    ----------
    twin : TwinMap
        The map.
    name : str
        The plan's name.
    radio : Radio
        The link.
    agent_height_m : float
        Height of the agent over the floor, which nothing tells; anchors are told relative to it.

    Raises
    ------
    InputError
        If the track is too short to be one.
    """
    from raytrace.plan.files import parse_floorplan
    from raytrace.plan.floorplan import FORMAT, VERSION

    parts = parts_of(twin)
    top = max([anchor.height_m for anchor in twin.anchors], default=0.0) + agent_height_m + _HEADROOM_M
    height = round(max(_LEAST_HEIGHT_M, top), 3)
    likeliest = _commonest([part.fit for wall in parts for part in wall if part.fit is not None])
    walls, known = [], []
    for wall, stem, cut in zip(twin.walls, _names(twin.walls), parts, strict=True):
        direction = (wall.ends_m[1] - wall.ends_m[0]) / wall.length_m
        for number, part in enumerate(cut):
            label = stem if len(cut) == 1 else f"{stem}-part-{number + 1}"
            slab = likeliest if part.fit is None else (part.fit.material, part.fit.thickness_m)
            start, end = wall.ends_m[0] + np.outer([part.from_m, part.to_m], direction)
            walls.append(_wall(label, start, end, height, slab))
            known.append(_wall_uncertainty(label, wall, part, number == 0, number + 1 == len(cut)))
    hidden = []
    for number, obstacle in enumerate(twin.obstacles):
        sides = [f"obstacle-{number}-{side}" for side in range(4)]
        for side, label in enumerate(sides):
            ends = obstacle.corners_m[side], obstacle.corners_m[(side + 1) % 4]
            walls.append(_wall(label, ends[0], ends[1], height, likeliest))
        hidden.append({"walls": sides, "existence": round(obstacle.existence, 4)})
    data = {
        "format": FORMAT,
        "version": VERSION,
        "name": name,
        "description": "Estimated from channels; origin: the agent's start, axes: its arrays at the start",
        "walls": walls,
        "anchors": [
            {
                "name": anchor.name,
                "position_m": [*_rounded(anchor.position_m), round(agent_height_m + anchor.height_m, 4)],
            }
            for anchor in twin.anchors
        ],
        "agent": _agent(twin, agent_height_m),
        "radio": radio.model_dump(mode="json", exclude_defaults=True),
        "tracing": {"engine": "images"},
        "uncertainty": {
            "rotation_std_rad": twin.rotation_std_rad,
            "epochs": len(twin.track_m),
            "walls": known,
            "obstacles": hidden,
            "anchors": [
                {
                    key: value
                    for key, value in {
                        "anchor": anchor.name,
                        "position_std_m": anchor.std_m,
                        "height_std_m": anchor.height_std_m,
                        "gain_offset_db": round(anchor.offset_db, 4),
                        "gain_offset_std_db": _number(anchor.offset_std_db),
                    }.items()
                    if value is not None
                }
                for anchor in twin.anchors
            ],
        },
    }
    return parse_floorplan(data, source=name)


def _wall(
    label: str, start: Array, end: Array, height_m: float, slab: tuple[str, float]
) -> dict[str, object]:
    return {
        "name": label,
        "from_m": _rounded(start),
        "to_m": _rounded(end),
        "height_m": height_m,
        "material": slab[0],
        "thickness_m": round(slab[1], 5),
    }


def _wall_uncertainty(
    label: str, wall: Stretch, part: WallPart, is_first: bool, is_last: bool
) -> dict[str, object]:
    """What the plan says of how sure a part of a wall is; where parts meet there is a corner."""
    fit = part.fit
    entry = {
        "wall": label,
        "from_end": wall.kinds[0] if is_first else "corner",
        "to_end": wall.kinds[1] if is_last else "corner",
        "from_std_m": _number(wall.std_m[0]) if is_first else None,
        "to_std_m": _number(wall.std_m[1]) if is_last else None,
        "assumed": wall.line < 0,
        "bounces": 0 if fit is None else fit.samples,
        "material_probabilities": {} if fit is None else _likely(fit.probabilities),
        "resolved": fit is not None and fit.clean >= _RESOLVED and fit.residual_db < _RESIDUAL_DB,
    }
    return {key: value for key, value in entry.items() if value is not None}


def _likely(probabilities: dict[str, float]) -> dict[str, float]:
    """Those that are worth a line."""
    return {name: round(share, 4) for name, share in probabilities.items() if share >= _LEAST_TOLD}


def _names(walls: tuple[Stretch, ...]) -> list[str]:
    """Walls by their line, further stretches of one with letters."""
    names: list[str] = []
    for wall in walls:
        stem = f"wall-{wall.line}" if wall.line >= 0 else "assumed"
        count = sum(1 for name in names if name == stem or name.startswith(f"{stem}-"))
        names.append(stem if not count else f"{stem}-{count + 1}")
    return names


def _commonest(fits: list[SlabFit]) -> tuple[str, float]:
    """Material and thickness of the wall that was heard best: that of walls which nobody heard."""
    if not fits:
        return _ASSUMED_MATERIAL, _ASSUMED_THICKNESS_M
    best = max(fits, key=lambda fit: fit.samples)
    return best.material, best.thickness_m


def _agent(twin: TwinMap, height_m: float) -> dict[str, object]:
    """The walked track: its positions as way-points, at its mean step."""
    points = [twin.track_m[0]]
    for point in twin.track_m[1:]:
        if np.linalg.norm(point - points[-1]) > 1e-3:
            points.append(point)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not steps.size:
        raise InputError("result: expected a track that moves, got one that stands still")
    step = float(steps.sum() / len(steps))
    speed = float(steps.sum() / max(float(twin.time_s[-1] - twin.time_s[0]), 1e-9))
    return {
        "waypoints_m": [_rounded(point) for point in points],
        "height_m": height_m,
        "speed_m_s": round(speed, 4),
        "step_m": round(step, 4),
        "epochs": int(steps.sum() / round(step, 4)) or 1,
        "smoothing_m": 0.0,
    }


def _rounded(point: Array) -> list[float]:
    return [round(float(value), 4) for value in point]


def _number(value: float) -> float | None:
    return round(value, 4) if np.isfinite(value) else None
