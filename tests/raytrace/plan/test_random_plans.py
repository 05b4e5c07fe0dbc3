"""Random plans: valid, walked through, seen, and traced without a loss."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from estimator.errors import ConfigurationError
from raytrace.plan.files import updated
from raytrace.plan.placement import place_anchors, plan_walk
from raytrace.plan.random_plans import KINDS, Kind, Start, random_plan
from raytrace.plan.trajectory import smoothed_track
from raytrace.propagation.comparison import compare
from raytrace.propagation.passive import trace_passive
from raytrace.propagation.plan_summary import floorplan_summary


@pytest.mark.parametrize("kind", KINDS)
def test_plans_are_sound_and_differ(kind: Kind) -> None:
    """Four seeds give four valid plans without a warning, whose agents walk and are seen all the way."""
    plans = [random_plan(kind, np.random.default_rng(seed)) for seed in range(4)]
    assert len({plan.sha256() for plan in plans}) == 4
    for plan in plans:
        summary = floorplan_summary(plan)
        assert summary["warnings"] == []
        assert plan.agent.epochs > 40
        assert max(summary["line_of_sight"].values()) > 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_equal_generators_give_equal_plans(kind: Kind) -> None:
    """A plan is a function of its kind and the generator's state."""
    one, other = (random_plan(kind, np.random.default_rng(7)) for _ in range(2))
    assert one.sha256() == other.sha256()


def test_kinds_have_what_they_promise() -> None:
    """Corners of an L, arms of a junction, rooms with doors and partitions, columns of four sides."""
    rng = np.random.default_rng(3)
    assert len(random_plan("rectangle", rng).walls) == 4
    assert len(random_plan("l-shape", rng).walls) == 6
    assert len(random_plan("corridor", rng).walls) in (8, 12)
    office = [wall.name for wall in random_plan("office", rng).walls]
    assert sum(name.endswith("-left") for name in office) >= 4
    assert any(name.startswith("between") for name in office)
    hall = [wall.name for wall in random_plan("hall", rng).walls if wall.name.startswith("column")]
    assert len(hall) >= 8
    assert len(hall) % 4 == 0
    racks = [wall for wall in random_plan("aisles", rng).walls if wall.name.startswith("rack")]
    assert len(racks) >= 8
    assert {wall.material for wall in racks} == {"metal"}
    assert max(wall.height_m for wall in racks) <= 2.5
    assert any(wall.name.startswith("core") for wall in random_plan("ring", rng).walls)
    assert any(wall.material == "glass" for wall in random_plan("shops", rng).walls)
    ends = np.array([(wall.from_m, wall.to_m) for wall in random_plan("bent", rng).walls])
    along = np.diff(ends, axis=1)[:, 0]
    bearing = np.degrees(np.arctan2(along[:, 1], along[:, 0]))
    assert np.abs((bearing - bearing[0] + 45.0) % 90.0 - 45.0).max() > 3.0  # no right angles alone


@pytest.mark.parametrize("kind", KINDS)
def test_walks_start_in_the_open_unless_asked(kind: Kind) -> None:
    """A start is farther from the nearest wall than one at an end, which is in a corner as a rule."""

    def gap_m(start: Start) -> float:
        plan = random_plan(kind, np.random.default_rng(5), start=start)
        walls = shapely.linestrings(np.stack(plan.walls_m(), axis=1))
        return float(shapely.distance(shapely.Point(plan.track()[0, :2]), walls).min())

    assert gap_m("open") > max(0.55, gap_m("end"))


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
def test_two_hundred_plans_of_a_kind(kind: Kind) -> None:
    """Of two hundred seeds each gives a valid plan without a warning, with a walk of fifty steps at least."""
    for seed in range(200):
        plan = random_plan(kind, np.random.default_rng([3, seed]))
        assert floorplan_summary(plan)["warnings"] == [], seed
        assert plan.agent.epochs >= 50, seed


@pytest.mark.parametrize("kind", KINDS)
def test_no_path_is_lost(kind: Kind) -> None:
    """The tracer finds all paths of the image method up to two bounces, and no other."""
    plan = random_plan(kind, np.random.default_rng(11), most_epochs=40)
    _, report = trace_passive(updated(plan, {"tracing.depth": 2}))
    assert (report.missing, report.extra) == (0, 0)
    assert report.found > 100


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_fifty_plans_are_traced(kind: Kind, seed: int) -> None:
    """Ten plans of every kind: nothing lost up to two bounces, at most a thousandth at three, nothing wrong.

    What is lost at the third bounce is in the report.
    """
    for depth in (1, 2, 3):
        epochs = 24 if depth == 3 else 60
        plan = random_plan(kind, np.random.default_rng(1000 + seed), most_epochs=epochs)
        plan = updated(plan, {"tracing.depth": depth})
        paths, report = trace_passive(plan)
        result = compare(plan, plan.track(), paths.flat())
        print(kind, seed, depth, report.as_dict(), {**result.as_dict(), "named": ()})  # noqa: T201
        assert result.missing == report.missing <= (1e-3 * report.expected if depth == 3 else 0)
        assert (result.extra, result.wrong) == (0, 0)


def test_an_unknown_kind_is_refused() -> None:
    """The message lists what there is."""
    with pytest.raises(ConfigurationError, match="expected one of rectangle, l-shape, .*got 'castle'"):
        random_plan("castle", np.random.default_rng(0))  # type: ignore[arg-type]


def test_a_walk_goes_through_doors() -> None:
    """In two rooms joined by a door of 90 cm, the walk visits both and keeps off the walls."""
    corners = np.array([(0, 0), (10, 0), (10, 5), (0, 5)], dtype=float)
    start = np.vstack([corners, [(5, 0), (5, 2.9)]])
    end = np.vstack([np.roll(corners, -1, axis=0), [(5, 2), (5, 5)]])
    walk = plan_walk(start, end, np.full(len(start), 0.1))
    track = smoothed_track(walk.waypoints_m, walk.smoothing_m, walk.step_m, walk.epochs)
    assert track[:, 0].min() < 1
    assert track[:, 0].max() > 9
    through = np.abs(track[:, 0] - 5) < 0.3
    assert np.all(np.abs(track[through, 1] - 2.45) < 0.3)
    assert walk.epochs == len(track) > 50


def test_anchors_see_the_walk() -> None:
    """In an L-shaped room each position sees two anchors, though no single place sees everything."""
    corners = np.array([(0, 0), (30, 0), (30, 4), (4, 4), (4, 30), (0, 30)], dtype=float)
    start, end = corners, np.roll(corners, -1, axis=0)
    track = np.vstack(
        [np.column_stack([np.linspace(29, 2, 40), np.full(40, 2.0)]), [(2, y) for y in range(3, 30)]]
    )
    anchors = place_anchors(start, end, np.full(len(start), 0.1), track)
    assert len(anchors) >= 2
    # A leg crosses the notch if it passes outside of both arms.
    share = np.linspace(0, 1, 201)[:, None, None, None]
    points = share * anchors[:, None] + (1 - share) * track
    inside = np.all((points[..., 0] <= 4) | (points[..., 1] <= 4), axis=0)
    assert inside.any(axis=0).all()
    assert np.mean(inside.sum(axis=0) >= 2) > 0.9
