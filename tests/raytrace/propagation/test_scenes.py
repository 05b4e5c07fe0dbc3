"""The scenes that ship: sound, and traced without a loss."""

from __future__ import annotations

import numpy as np
import pytest

from raytrace.plan.files import load_floorplan, shipped_scenes, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.comparison import compare
from raytrace.propagation.passive import trace_passive
from raytrace.propagation.plan_summary import floorplan_summary

ROOMS = ["corridor", "hall", "office", "warehouse"]


def thinned(plan: FloorPlan, epochs: int) -> FloorPlan:
    """The plan with an agent that stops at fewer places on the same way."""
    step = plan.agent.step_m * (plan.agent.epochs - 1) / (epochs - 1) * 0.999
    return updated(plan, {"agent.epochs": epochs, "agent.step_m": step})


@pytest.mark.parametrize("name", ROOMS)
def test_scenes_are_sound(name: str) -> None:
    """No walls on one another, no gaps by mistake, every anchor seen at times."""
    assert name in shipped_scenes()
    summary = floorplan_summary(load_floorplan(name))
    assert summary["warnings"] == []
    assert all(share > 0.1 for share in summary["line_of_sight"].values())
    assert summary["track_m"] > 50


@pytest.mark.parametrize("name", ROOMS)
@pytest.mark.parametrize("depth", [pytest.param(1, marks=pytest.mark.soak), 2])
def test_no_path_is_lost(name: str, depth: int) -> None:
    """At forty places along the way: every path of the image method, no other, and as strong as in theory."""
    plan = updated(thinned(load_floorplan(name), 40), {"tracing.depth": depth})
    paths, report = trace_passive(plan)
    assert (report.missing, report.extra) == (0, 0)
    assert report.found == report.expected > 100
    result = compare(plan, plan.track(), paths.flat())
    assert result.ok, result.as_dict()
    assert result.found == report.found
    assert result.amplitude_error_db < 1e-6


@pytest.mark.soak
@pytest.mark.parametrize("name", shipped_scenes())
@pytest.mark.parametrize("depth", [1, 2, 3])
def test_whole_scenes_are_traced(name: str, depth: int) -> None:
    """The whole way: nothing lost up to two bounces, at most a thousandth at three, nothing wrong."""
    plan = updated(load_floorplan(name), {"tracing.depth": depth})
    paths, report = trace_passive(plan)
    result = compare(plan, plan.track(), paths.flat())
    print(name, depth, report.as_dict(), {**result.as_dict(), "named": ()})  # noqa: T201
    assert result.missing == report.missing <= (1e-3 * report.expected if depth == 3 else 0)
    assert (result.extra, result.wrong) == (0, 0)


def test_the_office_has_doors_and_glass() -> None:
    """Seven rooms with a door each, two fronts of glass, and a walk through all seven doors."""
    plan = load_floorplan("office")
    fronts = [wall for wall in plan.walls if wall.name.startswith("front")]
    assert len(fronts) == 14
    assert sum(wall.material == "glass" for wall in fronts) == 4
    y = plan.track()[:, 1]
    crossings = np.sum(np.diff(np.sign(y - 5.5)) != 0) + np.sum(np.diff(np.sign(y - 7.7)) != 0)
    assert crossings >= 12
