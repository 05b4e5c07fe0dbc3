"""An estimated map as a floor plan: names, heights, materials, and how sure all of it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError

if TYPE_CHECKING:
    from estimator.twin.build import TwinMap
    from estimator.twin.stretches import Stretch
    from raytrace.plan.floorplan import FloorPlan
    from raytrace.plan.links import Radio
    from raytrace.propagation.slab_fit import SlabFit

__all__ = ["material_fits", "twin_plan"]

Array = NDArray[np.float64]
_HEADROOM_M = 0.5  # walls are higher than the highest anchor by this, and 3 m at least
_LEAST_HEIGHT_M = 3.0
_ASSUMED_MATERIAL, _ASSUMED_THICKNESS_M = "concrete", 0.2
_LEAST_BOUNCES = 3  # fewer tell no material


def material_fits(twin: TwinMap) -> dict[int, SlabFit]:
    """What each wall is made of, by line, where enough was heard of it."""
    from raytrace.propagation.slab_fit import fit_slab

    bounces, fits = twin.bounces, {}
    for line in sorted({wall.line for wall in twin.walls if wall.line >= 0}):
        mine = bounces.wall == line
        if mine.sum() >= _LEAST_BOUNCES:
            fits[line] = fit_slab(
                bounces.vertex_m[mine], bounces.loss_db[mine], bounces.noise_db[mine], twin.carrier_hz
            )
    return fits


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

    fits = material_fits(twin)
    top = max([anchor.height_m for anchor in twin.anchors], default=0.0) + agent_height_m + _HEADROOM_M
    height = round(max(_LEAST_HEIGHT_M, top), 3)
    names = _names(twin.walls)
    likeliest = _commonest(fits)
    walls, known = [], []
    for wall, label in zip(twin.walls, names, strict=True):
        fit = fits.get(wall.line)
        material, thickness = likeliest if fit is None else (fit.material, fit.thickness_m)
        walls.append(_wall(label, wall.ends_m[0], wall.ends_m[1], height, (material, thickness)))
        entry = {
            "wall": label,
            "from_end": wall.kinds[0],
            "to_end": wall.kinds[1],
            "from_std_m": _number(wall.std_m[0]),
            "to_std_m": _number(wall.std_m[1]),
            "assumed": wall.line < 0,
            "bounces": 0 if fit is None else fit.samples,
            "material_probabilities": {}
            if fit is None
            else {m: round(p, 4) for m, p in fit.probabilities.items() if p >= 5e-5},
        }
        known.append({key: value for key, value in entry.items() if value is not None})
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


def _names(walls: tuple[Stretch, ...]) -> list[str]:
    """Walls by their line, further stretches of one with letters."""
    names: list[str] = []
    for wall in walls:
        stem = f"wall-{wall.line}" if wall.line >= 0 else "assumed"
        count = sum(1 for name in names if name == stem or name.startswith(f"{stem}-"))
        names.append(stem if not count else f"{stem}-{count + 1}")
    return names


def _commonest(fits: dict[int, SlabFit]) -> tuple[str, float]:
    """Material and thickness of the wall that was heard best: that of walls which nobody heard."""
    if not fits:
        return _ASSUMED_MATERIAL, _ASSUMED_THICKNESS_M
    best = max(fits.values(), key=lambda fit: fit.samples)
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
