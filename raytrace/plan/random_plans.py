"""Random floor plans of many kinds, for statistics over buildings and for tests.

Every plan is valid, its agent walks through all of it where doors allow, and its
anchors see the walk. Equal kinds and generators in equal states give equal plans.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
import shapely
from numpy.typing import NDArray

from estimator.errors import ConfigurationError
from estimator.geometry import rotate
from raytrace.plan.files import parse_floorplan
from raytrace.plan.floorplan import FORMAT, VERSION, FloorPlan
from raytrace.plan.placement import place_anchors, plan_walk
from raytrace.plan.random_buildings import aisles, bent, corridor_ring, shops, suite
from raytrace.plan.random_rooms import DrawnWall, corridor, hall, l_shape, metres, office, rectangle
from raytrace.plan.space import main_space
from raytrace.plan.trajectory import smoothed_track

__all__ = ["KINDS", "Kind", "Start", "random_plan"]

Kind = Literal[
    "rectangle", "l-shape", "corridor", "office", "hall", "suite", "ring", "bent", "aisles", "shops"
]
KINDS: tuple[Kind, ...] = get_args(Kind)
Start = Literal["open", "end"]

_MAKERS: dict[str, Callable[[np.random.Generator], list[DrawnWall]]] = {
    "rectangle": rectangle,
    "l-shape": l_shape,
    "corridor": corridor,
    "office": office,
    "hall": hall,
    "suite": suite,
    "ring": corridor_ring,
    "bent": bent,
    "aisles": aisles,
    "shops": shops,
}
# Heights of rooms, metres: the highest of a kind, where it is not that of an office.
_LOWEST_M, _HIGHEST_M = 2.6, {"hall": 6.0, "aisles": 8.0, "shops": 4.5}
_OFFICE_M = 3.6
# Heights of what stands in them by the first part of a wall's name, metres.
_STANDING_M = {"rack": (1.8, 2.5), "counter": (0.9, 1.2)}
_SLABS = (("concrete", 0.3), ("wood", 0.1), ("plasterboard", 0.05))
_WITH_SLABS = 0.5  # share of buildings whose floor and ceiling reflect
_OPEN_M = 1.5  # from walls at the start, where there is a place so open


def random_plan(
    kind: Kind, rng: np.random.Generator, most_epochs: int = 236, start: Start = "open"
) -> FloorPlan:
    """Draw a plan.

    Parameters
    ----------
    kind : str
        ``rectangle`` and ``l-shape`` are single rooms; ``corridor`` is a junction of three or four
        arms; ``office`` has rooms with doors on both sides of a passage, partly of glass; ``hall``
        has columns; ``suite`` has rooms that doors join to one another; ``ring`` is a corridor around a
        core with rooms beside it; ``bent`` has odd angles; ``aisles`` has rows of metal racks; ``shops``
        have glass fronts on a wide passage, and counters.
    rng : numpy.random.Generator
        All randomness.
    most_epochs : int
        Length of the agent's walk.
    start : {"open", "end"}
        Where the walk starts: away from walls, or at one end of the space, in a corner as a rule.

    Raises
    ------
    ConfigurationError
        If there is no such kind.
    """
    if kind not in _MAKERS:
        raise ConfigurationError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    walls = _MAKERS[kind](rng)
    turn = float(rng.uniform(-np.pi, np.pi)) if rng.random() < 0.5 else 0.0
    ends = np.round(rotate(np.array([wall[1:3] for wall in walls]), turn), 4)
    height = float(metres(rng, _LOWEST_M, _HIGHEST_M.get(kind, _OFFICE_M)))
    standing = {part: float(metres(rng, *span)) for part, span in _STANDING_M.items()}
    thickness = np.array([wall[4] for wall in walls])
    free = main_space(ends[:, 0], ends[:, 1], thickness).free
    place = _open_place(free, rng) if start == "open" else None
    walk = plan_walk(ends[:, 0], ends[:, 1], thickness, most_epochs, free=free, start_at_m=place)
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
                "from_m": one.tolist(),
                "to_m": other.tolist(),
                "height_m": min(height, standing.get(name.split("-")[0], height)),
                "material": material,
                "thickness_m": thick,
            }
            for (name, _, _, material, thick), (one, other) in zip(walls, ends, strict=True)
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
        "echo": {"sweep_every": 1},
    }
    if rng.random() < _WITH_SLABS:
        for slab in ("floor", "ceiling"):
            material, thick = _SLABS[int(rng.integers(len(_SLABS)))]
            data[slab] = {"material": material, "thickness_m": thick}
    return parse_floorplan(data, source=f"random {kind}")


def _open_place(free: shapely.Geometry, rng: np.random.Generator) -> tuple[float, float]:
    """A place that is drawn from what lies far enough from all walls, or the farthest one."""
    centre, rim = shapely.get_coordinates(shapely.maximum_inscribed_circle(free, tolerance=0.05))
    most_m = float(np.linalg.norm(rim - centre))
    open_part = shapely.buffer(free, -min(_OPEN_M, 0.8 * most_m))
    left, bottom, right, top = shapely.bounds(open_part)
    places: NDArray[np.float64] = rng.uniform((left, bottom), (right, top), (200, 2))
    inside = places[shapely.contains_xy(open_part, places)]
    x, y = inside[0] if len(inside) else centre
    return float(x), float(y)
