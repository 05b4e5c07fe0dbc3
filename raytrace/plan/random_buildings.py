"""Walls of buildings, drawn at random: suites, corridor rings, odd angles, aisles of racks, shops."""

from __future__ import annotations

import itertools

import numpy as np

from raytrace.plan.random_rooms import GLASS, INNER, OUTER, DrawnWall, Point, box, edges, metres, pick, ring

__all__ = ["aisles", "bent", "corridor_ring", "shops", "suite"]

_DOORS_M = (0.9, 1.0, 1.2)
_JAMB_M = 0.4  # from a door to the next corner


def suite(rng: np.random.Generator) -> list[DrawnWall]:
    """Rooms beside and behind one another; doors join all of them, some in more ways than one."""
    columns, rows = (int(count) for count in rng.integers(2, 4, 2))
    sides = metres(rng, 4.0, 6.5, 2)
    width, depth = float(columns * sides[0]), float(rows * sides[1])
    xs, ys = edges(rng, width, columns), edges(rng, depth, rows)
    partition = pick(rng, INNER)
    walls = ring("outer", box(0.0, 0.0, width, depth), pick(rng, OUTER))
    cells = list(itertools.product(range(columns), range(rows)))
    borders = [(cell, (cell[0] + dx, cell[1] + dy)) for cell in cells for dx, dy in ((1, 0), (0, 1))]
    borders = [border for border in borders if border[1] in cells]
    joined = {cell: cell for cell in cells}
    for number in rng.permutation(len(borders)):
        one, other = borders[number]
        needed = joined[one] != joined[other]
        joined = {cell: joined[one] if root == joined[other] else root for cell, root in joined.items()}
        column, row = other
        if one[1] == other[1]:  # side by side: an upright border
            start, end = (xs[column], ys[row]), (xs[column], ys[row + 1])
        else:
            start, end = (xs[column], ys[row]), (xs[column + 1], ys[row])
        name = f"between-{number + 1}"
        if needed or rng.random() < 0.3:
            walls += _with_door(rng, name, start, end, partition, float(rng.choice(_DOORS_M)))
        else:
            walls.append((name, start, end, *partition))
    return walls


def corridor_ring(rng: np.random.Generator) -> list[DrawnWall]:
    """A corridor around a core, and rooms with doors on one side of it or two."""
    across = float(metres(rng, 1.8, 3.0))
    core = [float(side) for side in metres(rng, 6.0, 16.0, 2)]
    width, depth = core[0] + 2.0 * across, core[1] + 2.0 * across
    partition, sides = pick(rng, INNER), int(rng.integers(1, 3))
    rooms = [float(room) for room in metres(rng, 3.5, 5.5, 2)]
    low, high = -rooms[0], depth + (rooms[1] if sides == 2 else 0.0)
    walls = ring("outer", box(0.0, low, width, high - low), pick(rng, OUTER))
    walls += ring("core", box(across, across, *core), pick(rng, OUTER))
    for side, (front, back) in enumerate(((0.0, low), (depth, high))[:sides]):
        limits = edges(rng, width, max(2, int(width / 5.0)))
        for room, (left, right) in enumerate(itertools.pairwise(limits)):
            name = f"{'ab'[side]}{room + 1}"
            door = float(rng.choice(_DOORS_M))
            material = GLASS if rng.random() < 0.2 else partition
            walls += _with_door(rng, f"front-{name}", (left, front), (right, front), material, door)
            if room:
                walls.append((f"between-{name}", (left, back), (left, front), *partition))
    return walls


def bent(rng: np.random.Generator) -> list[DrawnWall]:
    """A room of five to eight corners at odd angles, and one or two walls into it from its sides."""
    corners = int(rng.integers(5, 9))
    turn = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    radius = rng.uniform(6.0, 13.0, corners)
    around = np.round(np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1), 3)
    walls = ring("wall", [(float(x), float(y)) for x, y in around], pick(rng, OUTER))
    partition = pick(rng, INNER)
    for number, side in enumerate(rng.choice(corners, int(rng.integers(1, 3)), replace=False)):
        foot = around[side] + rng.uniform(0.35, 0.65) * (around[(side + 1) % corners] - around[side])
        tip = foot * rng.uniform(0.45, 0.7)  # towards the middle
        walls.append((f"into-{number + 1}", _point(foot), _point(tip), *partition))
    return walls


def aisles(rng: np.random.Generator) -> list[DrawnWall]:
    """A hall with rows of metal racks, aisles between them and around."""
    rows, deep = int(rng.integers(2, 6)), float(metres(rng, 0.8, 1.4))
    aisle, around = (float(gap) for gap in metres(rng, 2.2, 3.5, 2))
    lengths = [float(length) for length in metres(rng, 6.0, 16.0, int(rng.integers(1, 3)))]
    cross = float(metres(rng, 2.5, 4.0))
    width = 2.0 * around + sum(lengths) + cross * (len(lengths) - 1)
    depth = 2.0 * around + rows * deep + (rows - 1) * aisle
    walls = ring("outer", box(0.0, 0.0, round(width, 4), round(depth, 4)), pick(rng, OUTER))
    for row in range(rows):
        x = around
        for number, length in enumerate(lengths):
            corners = box(x, around + row * (deep + aisle), length, deep)
            walls += ring(f"rack-{row + 1}{'ab'[number]}", corners, ("metal", 0.02))
            x += length + cross
    return walls


def shops(rng: np.random.Generator) -> list[DrawnWall]:
    """Shops on both sides of a wide passage, with glass fronts, wide entrances and counters."""
    passage = float(metres(rng, 3.5, 6.0))
    depths = [float(depth) for depth in metres(rng, 5.0, 9.0, 2)]
    width = float(metres(rng, 14.0, 28.0))
    bottom, top = depths[0], depths[0] + passage
    height, partition = round(top + depths[1], 4), pick(rng, INNER)
    walls = ring("outer", box(0.0, 0.0, width, height), pick(rng, OUTER))
    for side, (front, back) in enumerate(((bottom, 0.0), (top, height))):
        limits = edges(rng, width, max(2, int(width / rng.uniform(5.5, 8.0))))
        for shop, (left, right) in enumerate(itertools.pairwise(limits)):
            name = f"{'ab'[side]}{shop + 1}"
            entrance = float(metres(rng, 1.5, 2.6))
            walls += _with_door(rng, f"front-{name}", (left, front), (right, front), GLASS, entrance)
            if shop:
                walls.append((f"between-{name}", (left, back), (left, front), *partition))
            if rng.random() < 0.5:
                x, y = 0.5 * (left + right) - 1.0, back + (1.6 if back < front else -2.3)
                walls += ring(f"counter-{name}", box(x, y, 2.0, 0.7), ("wood", 0.04))
    return walls


def _with_door(
    rng: np.random.Generator, name: str, start: Point, end: Point, made_of: tuple[str, float], door_m: float
) -> list[DrawnWall]:
    """A wall with a gap, a jamb at least from either end."""
    ends = np.array([start, end])
    length = float(np.linalg.norm(ends[1] - ends[0]))
    hinge = rng.uniform(_JAMB_M, length - _JAMB_M - door_m)
    along = (ends[1] - ends[0]) / length
    gap = ends[0] + along * hinge, ends[0] + along * (hinge + door_m)
    left, right = _point(gap[0]), _point(gap[1])
    return [(f"{name}-left", start, left, *made_of), (f"{name}-right", right, end, *made_of)]


def _point(place: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Point:
    return round(float(place[0]), 3), round(float(place[1]), 3)
