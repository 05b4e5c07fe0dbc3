"""Random floor plans of a few kinds, for statistics over rooms and for tests.

Every plan is valid, its agent walks through all of it where doors allow, and its
anchors see the walk. Equal kinds and generators in equal states give equal plans.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

import numpy as np

from estimator.errors import ConfigurationError
from estimator.geometry import rotate
from raytrace.plan.files import parse_floorplan
from raytrace.plan.floorplan import FORMAT, VERSION, FloorPlan
from raytrace.plan.placement import place_anchors, plan_walk
from raytrace.plan.trajectory import smoothed_track

__all__ = ["KINDS", "Kind", "random_plan"]

Kind = Literal["rectangle", "l-shape", "corridor", "office", "hall"]
KINDS: tuple[Kind, ...] = get_args(Kind)

_Point = tuple[float, float]
_Wall = tuple[str, _Point, _Point, str, float]

_OUTER = (("concrete", 0.3), ("concrete", 0.2), ("brick", 0.24))
_INNER = (("plasterboard", 0.1), ("brick", 0.12), ("chipboard", 0.05))
_GLASS = ("glass", 0.02)


def random_plan(kind: Kind, rng: np.random.Generator, most_epochs: int = 236) -> FloorPlan:
    """Draw a plan.

    Parameters
    ----------
    kind : {"rectangle", "l-shape", "corridor", "office", "hall"}
        ``corridor`` is a junction of three or four arms; ``office`` has rooms with
        doors on both sides of a passage, partly of glass; ``hall`` has columns.
    rng : numpy.random.Generator
        All randomness.
    most_epochs : int
        Length of the agent's walk.

    Raises
    ------
    ConfigurationError
        If there is no such kind.
    """
    makers: dict[str, Callable[[np.random.Generator], list[_Wall]]] = {
        "rectangle": _rectangle,
        "l-shape": _l_shape,
        "corridor": _corridor,
        "office": _office,
        "hall": _hall,
    }
    if kind not in makers:
        raise ConfigurationError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    walls = makers[kind](rng)
    turn = float(rng.uniform(-np.pi, np.pi)) if rng.random() < 0.5 else 0.0
    ends = np.round(rotate(np.array([wall[1:3] for wall in walls]), turn), 4)
    height = float(_metres(rng, 2.6, 6.0 if kind == "hall" else 3.6))
    thickness = np.array([wall[4] for wall in walls])
    walk = plan_walk(ends[:, 0], ends[:, 1], thickness, most_epochs)
    track = smoothed_track(walk.waypoints_m, walk.smoothing_m, walk.step_m, walk.epochs)
    anchors = place_anchors(ends[:, 0], ends[:, 1], thickness, track)
    data: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": f"random-{kind}",
        "description": f"A random plan of kind {kind}",
        "walls": [
            {
                "name": name,
                "from_m": start.tolist(),
                "to_m": end.tolist(),
                "height_m": height,
                "material": material,
                "thickness_m": thickness,
            }
            for (name, _, _, material, thickness), (start, end) in zip(walls, ends, strict=True)
        ],
        "anchors": [
            {"name": f"pa{number}", "position_m": (float(x), float(y), round(height - 0.4, 3))}
            for number, (x, y) in enumerate(anchors, 1)
        ],
        "agent": {
            "waypoints_m": walk.waypoints_m,
            "height_m": 1.5,
            "step_m": walk.step_m,
            "speed_m_s": walk.step_m,
            "epochs": walk.epochs,
            "smoothing_m": walk.smoothing_m,
        },
        "radio": {"timing_jitter_s": 1e-10},
    }
    return parse_floorplan(data, source=f"random {kind}")


def _metres(rng: np.random.Generator, low: float, high: float, size: int | None = None) -> Any:
    """Uniform lengths in whole centimetres."""
    return np.round(rng.uniform(low, high, size), 2)


def _ring(prefix: str, corners: Sequence[_Point], material: tuple[str, float]) -> list[_Wall]:
    """Walls around corners."""
    following = [*corners[1:], corners[0]]
    return [
        (f"{prefix}-{number}", one, other, *material)
        for number, (one, other) in enumerate(zip(corners, following, strict=True), 1)
    ]


def _box(x: float, y: float, width: float, depth: float) -> list[_Point]:
    corners = [(x, y), (x + width, y), (x + width, y + depth), (x, y + depth)]
    return [(round(float(a), 4), round(float(b), 4)) for a, b in corners]


def _pick(rng: np.random.Generator, choices: tuple[tuple[str, float], ...]) -> tuple[str, float]:
    return choices[int(rng.integers(len(choices)))]


def _rectangle(rng: np.random.Generator) -> list[_Wall]:
    width, depth = _metres(rng, 6.0, 40.0), _metres(rng, 5.0, 25.0)
    return _ring("wall", _box(0.0, 0.0, width, depth), _pick(rng, _OUTER))


def _l_shape(rng: np.random.Generator) -> list[_Wall]:
    width, depth = _metres(rng, 12.0, 60.0), _metres(rng, 10.0, 45.0)
    x, y = (float(np.round(side * rng.uniform(0.35, 0.65), 2)) for side in (width, depth))
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (x, depth), (x, y), (0.0, y)]
    return _ring("wall", corners, _pick(rng, _OUTER))


def _corridor(rng: np.random.Generator) -> list[_Wall]:
    """Arms east, north, west and perhaps south of a junction, each of its own length."""
    across, along = _metres(rng, 2.0, 4.0), _metres(rng, 2.0, 4.0)
    east, north, west, south = _metres(rng, 6.0, 25.0, 4)
    x, y = 0.5 * across, 0.5 * along
    corners = [(x, y), (x, y + north), (-x, y + north), (-x, y), (-x - west, y), (-x - west, -y)]
    if rng.random() < 0.5:
        corners += [(-x, -y), (-x, -y - south), (x, -y - south), (x, -y)]
    corners += [(x + east, -y), (x + east, y)]
    return _ring("wall", [(float(a), float(b)) for a, b in corners], _pick(rng, _OUTER))


def _office(rng: np.random.Generator) -> list[_Wall]:
    """Rooms below and above a passage; some of their fronts are glass, all have a door."""
    passage = float(_metres(rng, 1.8, 3.0))
    rooms, partition = [int(rng.integers(2, 5)) for _ in range(2)], _pick(rng, _INNER)
    depths = [float(depth) for depth in _metres(rng, 3.5, 6.0, 2)]
    width = float(_metres(rng, 4.0, 5.5)) * max(rooms)
    bottom, top = depths[0], depths[0] + passage
    height = round(top + depths[1], 4)
    walls = _ring("outer", _box(0.0, 0.0, width, height), _pick(rng, _OUTER))
    for side, (count, front, back) in enumerate(zip(rooms, (bottom, top), (0.0, height), strict=True)):
        edges = _edges(rng, width, count)
        for room, (left, right) in enumerate(itertools.pairwise(edges)):
            door = float(rng.choice([0.9, 1.0, 1.2]))
            hinge = round(float(rng.uniform(left + 0.4, right - 0.4 - door)), 3)
            material = _GLASS if rng.random() < 0.3 else partition
            name = f"front-{'ab'[side]}{room + 1}"
            walls.append((f"{name}-left", (left, front), (hinge, front), *material))
            walls.append((f"{name}-right", (round(hinge + door, 3), front), (right, front), *material))
            if room:
                walls.append((f"between-{'ab'[side]}{room}", (left, back), (left, front), *partition))
    return walls


def _edges(rng: np.random.Generator, width: float, count: int) -> list[float]:
    """Limits of rooms of about equal width."""
    share = np.cumsum(rng.uniform(0.8, 1.2, count))
    return [0.0, *(round(float(edge), 3) for edge in width * share[:-1] / share[-1]), width]


def _hall(rng: np.random.Generator) -> list[_Wall]:
    """A rectangle with a lattice of square columns."""
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    bay_x, bay_y = (float(bay) for bay in _metres(rng, 6.0, 9.0, 2))
    side = float(_metres(rng, 0.4, 0.8))
    outer = _box(0.0, 0.0, round((columns + 1) * bay_x, 4), round((rows + 1) * bay_y, 4))
    walls = _ring("outer", outer, _pick(rng, _OUTER))
    for column in range(columns):
        for row in range(rows):
            x, y = (column + 1) * bay_x - 0.5 * side, (row + 1) * bay_y - 0.5 * side
            name = f"column-{column + 1}{row + 1}"
            walls += _ring(name, _box(x, y, side, side), ("concrete", 0.2))
    return walls
