"""Small plans that were once read or traced wrongly, each with its right behaviour."""

from __future__ import annotations

from pathlib import Path

import pytest

from raytrace.plan.files import load_floorplan
from raytrace.propagation.passive import trace_passive
from raytrace.propagation.plan_summary import floorplan_summary

CASES = Path(__file__).parents[3].parent / "shared" / "cases" / "floorplans"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not beside this checkout")


@pytest.mark.parametrize(
    ("case", "paths"),
    [("07/utm", 78), ("08/dupwall", 78), ("12/door", 78), ("14/bom", 104), ("18/diffr", 22)],
)
def test_every_path_is_found(case: str, paths: int) -> None:
    """UTM coordinates, a wall drawn twice, a door's gap, a byte-order mark, a free end: nothing is lost."""
    _, report = trace_passive(load_floorplan(CASES / f"{case}.toml"))
    assert (report.expected, report.found, report.extra) == (paths, paths, 0)


def test_a_duplicate_wall_is_told() -> None:
    """The plan is traced with one wall of the two, and the summary says so."""
    summary = floorplan_summary(load_floorplan(CASES / "08" / "dupwall.toml"))
    assert summary["walls"] == 4
    assert summary["repairs"] == ["walls 'w1' and 'dup' lie on one another: made one"]


def test_a_door_leaves_a_room() -> None:
    """The room with a gap of a metre in its wall is the space of the agent, all of it."""
    summary = floorplan_summary(load_floorplan(CASES / "12" / "door.toml"))
    assert summary["space"]["kind"] == "inside"
    assert summary["space"]["share"] > 0.99
