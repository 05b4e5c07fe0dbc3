"""Beams among walls: what they leave out loses no path, and a large building costs what a small one does."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely

from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.random_plans import KINDS, random_plan
from raytrace.propagation import images
from raytrace.propagation.beams import lit_walls
from raytrace.propagation.images import image_paths
from raytrace.propagation.obstacles import blocked
from raytrace.propagation.reflectors import surfaces_of
from raytrace.propagation.sequences import lit_sequences


def rooms(columns: int, rows: int) -> FloorPlan:
    """Rooms of 5 m x 4 m with a door to each neighbour; the agent and an anchor in the middle."""
    rng = np.random.default_rng(1)
    width, depth = 5.0 * columns, 4.0 * rows
    ends = [
        ((0, 0), (width, 0)),
        ((width, 0), (width, depth)),
        ((width, depth), (0, depth)),
        ((0, depth), (0, 0)),
    ]
    for column, row in itertools.product(range(columns), range(rows)):
        x, y = 5.0 * column, 4.0 * row
        door = round(float(rng.uniform(0.5, 2.5)), 3)
        if column:
            ends += [((x, y), (x, y + door)), ((x, y + door + 1.0), (x, y + 4.0))]
        if row:
            ends += [((x, y), (x + door, y)), ((x + door + 1.0, y), (x + 5.0, y))]
    x, y = 5.0 * (columns // 2) + 2.0, 4.0 * (rows // 2) + 2.0
    return parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "rooms",
            "walls": [
                {"name": f"w{i}", "from_m": list(a), "to_m": list(b), "thickness_m": 0.1}
                for i, (a, b) in enumerate(ends)
            ],
            "floor": {"material": "concrete"},
            "ceiling": {"material": "concrete"},
            "anchors": [{"name": "pa", "position_m": [x + 1.5, y + 0.7, 2.5]}],
            "agent": {"waypoints_m": [[x, y], [x + 1.0, y]], "step_m": 0.2, "epochs": 5, "smoothing_m": 0.0},
        }
    )


def of_all_sequences(plan: FloorPlan, depth: int, monkeypatch: pytest.MonkeyPatch) -> tuple[list, list]:
    """Paths with beams, and those of every sequence of surfaces there is."""
    places = plan.track()[:: max(1, plan.agent.epochs // 6)]
    found = image_paths(plan, places, depth, rim_m=1e-6).flat()
    with monkeypatch.context() as patch:
        patch.setattr(images, "lit_sequences", lambda *a, blind: lit_sequences(*a, blind=True))
        every = image_paths(plan, places, depth, rim_m=1e-6).flat()
    return [
        list(zip(paths.epoch, paths.anchor, map(tuple, paths.walls), paths.delay_s, strict=True))
        for paths in (found, every)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_beams_lose_no_path(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The paths are those of all sequences of surfaces, to the same bits."""
    for seed in range(3):
        plan = random_plan(kind, np.random.default_rng([seed, 11]), most_epochs=30)
        found, every = of_all_sequences(plan, 2, monkeypatch)
        assert found == every
        assert len(found) > 20


def test_beams_lose_no_path_of_three_bounces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor at the third order, in rooms whose doors let little through."""
    found, every = of_all_sequences(rooms(3, 2), 3, monkeypatch)
    assert found == every
    assert any(min(walls) >= 0 for _, _, walls, _ in found)


def test_a_beam_lights_what_a_sample_of_rays_meets() -> None:
    """From a point: every wall that some ray of 2,000 meets first is lit, where it meets it."""
    plan = rooms(5, 4)
    surfaces, place = surfaces_of(plan), plan.anchors_m()[:1]
    _, wall, spans = lit_walls(surfaces, place, np.array([-1]), np.zeros((1, 2)), 3.0)
    lit = dict(zip(wall.tolist(), spans, strict=True))
    start, end = plan.walls_m()
    lines = shapely.linestrings(np.stack([start, end], axis=1))
    rng = np.random.default_rng(2)
    met = set()
    for azimuth in rng.uniform(-np.pi, np.pi, 2000):
        far = place[0, :2] + 100.0 * np.array([np.cos(azimuth), np.sin(azimuth)])
        ray = shapely.linestrings([place[0, :2], far])
        points = shapely.intersection(ray, lines)
        distance = shapely.distance(points, shapely.Point(place[0, :2]))
        first = int(np.nanargmin(distance))
        at = float(np.linalg.norm(shapely.get_coordinates(points[first])[0] - start[first]))
        assert lit[first][0] - 1e-6 <= at <= lit[first][1] + 1e-6
        met.add(first)
    assert len(met) > 8
    assert len(lit) < 2 * len(met) < len(lines)  # and, beside what is seen past a jamb, little else is


def test_a_hidden_room_costs_nothing() -> None:
    """Sequences in a building of 1,600 rooms are few more than those in one of 49."""
    counts = []
    for size in (7, 40):
        plan = rooms(size, size)
        found = list(lit_sequences(surfaces_of(plan), plan.anchors_m()[0], 2, plan.ceiling_height_m))
        counts.append(len(found[-1]))
    assert counts[0] > 200
    assert counts[1] < 1.5 * counts[0]


def test_a_low_wall_hides_nothing() -> None:
    """A wall behind a screen is lit where paths pass above it, and is not where none is so high."""
    plan = updated(rooms(1, 1), {"floor": None, "ceiling": None})
    data = plan.model_dump(mode="json", exclude_none=True)
    x, y, _ = plan.anchors[0].position_m
    screen = {"name": "screen", "from_m": [x - 0.5, y - 5.0], "to_m": [x - 0.5, y + 5.0], "height_m": 1.0}
    surfaces = surfaces_of(
        parse_floorplan(
            {
                **data,
                "walls": [*data["walls"], screen],
                "agent": {
                    "waypoints_m": [[x + 0.2, y], [x + 0.5, y]],
                    "epochs": 2,
                    "step_m": 0.1,
                    "smoothing_m": 0.0,
                },
            }
        )
    )
    behind = 3  # the western wall
    for top, lit in ((2.5, True), (0.9, False)):
        _, walls, _ = lit_walls(surfaces, np.array([[x, y, 0.5]]), np.array([-1]), np.zeros((1, 2)), top)
        assert (behind in walls) is lit


def test_legs_meet_what_lies_on_them() -> None:
    """Legs anywhere in a building of 300 walls are blocked as planar geometry says."""
    plan = updated(rooms(9, 9), {"floor": None, "ceiling": None})
    surfaces, rng = surfaces_of(plan), np.random.default_rng(4)
    ends = np.dstack(
        [rng.uniform(-5.0, 50.0, (2, 4000)), rng.uniform(-5.0, 41.0, (2, 4000)), np.full((2, 4000), 1.5)]
    )
    ends[1, 2000:, :2] = ends[0, 2000:, :2] + rng.normal(0.0, 2.0, (2000, 2))  # half of them are short
    ends[1, :100, 0] = ends[0, :100, 0]  # some along the grid of walls
    start, end = plan.walls_m()
    walls = shapely.multilinestrings(list(np.stack([start, end], axis=1)))
    legs = shapely.linestrings(np.moveaxis(ends[..., :2], 0, 1))
    gap = shapely.distance(legs, walls)
    decided = (gap == 0.0) | (gap > 1e-5)
    met = blocked(surfaces, ends[0], ends[1])
    np.testing.assert_array_equal(met[decided], gap[decided] == 0.0)
    assert 0.2 < met.mean() < 0.95


def test_a_plan_in_one_line_has_cells() -> None:
    """Walls in one line, and a single wall, block what crosses them."""
    plan = updated(load_floorplan("l-room"), {"floor": None, "ceiling": None})
    for walls in ([((0, 0), (4, 0)), ((6, 0), (9, 0))], [((0, 0), (0, 5))]):
        data = plan.model_dump(mode="json", exclude_none=True)
        data |= {
            "walls": [
                {"name": f"w{i}", "from_m": list(a), "to_m": list(b)} for i, (a, b) in enumerate(walls)
            ],
            "anchors": [{"name": "pa", "position_m": [3.0, 3.0, 1.5]}],
            "agent": {
                "waypoints_m": [[3.0, 1.0], [4.0, 1.0]],
                "epochs": 2,
                "step_m": 0.5,
                "smoothing_m": 0.0,
            },
        }
        surfaces = surfaces_of(parse_floorplan(data))
        (x0, y0), (x1, y1) = walls[0]
        middle, along = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)]), np.array([x1 - x0, y1 - y0])
        across = np.array([-along[1], along[0]])
        ends = np.array(
            [[*(middle - across), 1.5], [*(middle + across), 1.5], [*(middle + 0.5 * across), 1.5]]
        )
        np.testing.assert_array_equal(blocked(surfaces, ends[[0, 1]], ends[[1, 2]]), [True, False])
