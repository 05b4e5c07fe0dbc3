"""Walls of single rooms and simple plans, drawn at random, and what all random plans are drawn with."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = [
    "GLASS",
    "INNER",
    "OUTER",
    "DrawnWall",
    "Point",
    "box",
    "corridor",
    "edges",
    "hall",
    "l_shape",
    "metres",
    "office",
    "pick",
    "rectangle",
    "ring",
]

Point = tuple[float, float]
DrawnWall = tuple[str, Point, Point, str, float]
"""Name, ends in metres, material and thickness in metres."""

OUTER = (("concrete", 0.3), ("concrete", 0.2), ("brick", 0.24))
INNER = (("plasterboard", 0.1), ("brick", 0.12), ("chipboard", 0.05))
GLASS = ("glass", 0.02)


def metres(rng: np.random.Generator, low: float, high: float, size: int | None = None) -> Any:
    """Uniform lengths in whole centimetres."""
    return np.round(rng.uniform(low, high, size), 2)


def ring(prefix: str, corners: Sequence[Point], material: tuple[str, float]) -> list[DrawnWall]:
    """Walls around corners."""
    following = [*corners[1:], corners[0]]
    return [
        (f"{prefix}-{number}", one, other, *material)
        for number, (one, other) in enumerate(zip(corners, following, strict=True), 1)
    ]


def box(x: float, y: float, width: float, depth: float) -> list[Point]:
    """Corners of a rectangle, counter-clockwise from its lower left one."""
    corners = [(x, y), (x + width, y), (x + width, y + depth), (x, y + depth)]
    return [(round(float(a), 4), round(float(b), 4)) for a, b in corners]


def pick(rng: np.random.Generator, choices: tuple[tuple[str, float], ...]) -> tuple[str, float]:
    """One of the choices."""
    return choices[int(rng.integers(len(choices)))]


def rectangle(rng: np.random.Generator) -> list[DrawnWall]:
    """A room of four walls."""
    width, depth = metres(rng, 6.0, 40.0), metres(rng, 5.0, 25.0)
    return ring("wall", box(0.0, 0.0, width, depth), pick(rng, OUTER))


def l_shape(rng: np.random.Generator) -> list[DrawnWall]:
    """A room of six walls."""
    width, depth = metres(rng, 12.0, 60.0), metres(rng, 10.0, 45.0)
    x, y = (float(np.round(side * rng.uniform(0.35, 0.65), 2)) for side in (width, depth))
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (x, depth), (x, y), (0.0, y)]
    return ring("wall", corners, pick(rng, OUTER))


def corridor(rng: np.random.Generator) -> list[DrawnWall]:
    """Arms east, north, west and perhaps south of a junction, each of its own length."""
    across, along = metres(rng, 2.0, 4.0), metres(rng, 2.0, 4.0)
    east, north, west, south = metres(rng, 6.0, 25.0, 4)
    x, y = 0.5 * across, 0.5 * along
    corners = [(x, y), (x, y + north), (-x, y + north), (-x, y), (-x - west, y), (-x - west, -y)]
    if rng.random() < 0.5:
        corners += [(-x, -y), (-x, -y - south), (x, -y - south), (x, -y)]
    corners += [(x + east, -y), (x + east, y)]
    return ring("wall", [(float(a), float(b)) for a, b in corners], pick(rng, OUTER))


def office(rng: np.random.Generator) -> list[DrawnWall]:
    """Rooms below and above a passage; some of their fronts are glass, all have a door."""
    passage = float(metres(rng, 1.8, 3.0))
    rooms, partition = [int(rng.integers(2, 5)) for _ in range(2)], pick(rng, INNER)
    depths = [float(depth) for depth in metres(rng, 3.5, 6.0, 2)]
    width = float(metres(rng, 4.0, 5.5)) * max(rooms)
    bottom, top = depths[0], depths[0] + passage
    height = round(top + depths[1], 4)
    walls = ring("outer", box(0.0, 0.0, width, height), pick(rng, OUTER))
    for side, (count, front, back) in enumerate(zip(rooms, (bottom, top), (0.0, height), strict=True)):
        limits = edges(rng, width, count)
        for room, (left, right) in enumerate(itertools.pairwise(limits)):
            door = float(rng.choice([0.9, 1.0, 1.2]))
            hinge = round(float(rng.uniform(left + 0.4, right - 0.4 - door)), 3)
            material = GLASS if rng.random() < 0.3 else partition
            name = f"front-{'ab'[side]}{room + 1}"
            walls.append((f"{name}-left", (left, front), (hinge, front), *material))
            walls.append((f"{name}-right", (round(hinge + door, 3), front), (right, front), *material))
            if room:
                walls.append((f"between-{'ab'[side]}{room}", (left, back), (left, front), *partition))
    return walls


def edges(rng: np.random.Generator, width: float, count: int) -> list[float]:
    """Limits of rooms of about equal width."""
    share = np.cumsum(rng.uniform(0.8, 1.2, count))
    return [0.0, *(round(float(edge), 3) for edge in width * share[:-1] / share[-1]), width]


def hall(rng: np.random.Generator) -> list[DrawnWall]:
    """A rectangle with a lattice of square columns."""
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    bay_x, bay_y = (float(bay) for bay in metres(rng, 6.0, 9.0, 2))
    side = float(metres(rng, 0.4, 0.8))
    outer = box(0.0, 0.0, round((columns + 1) * bay_x, 4), round((rows + 1) * bay_y, 4))
    walls = ring("outer", outer, pick(rng, OUTER))
    for column in range(columns):
        for row in range(rows):
            x, y = (column + 1) * bay_x - 0.5 * side, (row + 1) * bay_y - 0.5 * side
            name = f"column-{column + 1}{row + 1}"
            walls += ring(name, box(x, y, side, side), ("concrete", 0.2))
    return walls
