"""Plans as files: written, described by a schema, summed up."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import jsonschema_rs
import numpy as np
import pytest

from estimator.errors import OutputExistsError
from raytrace.plan.files import (
    floorplan_schema,
    load_floorplan,
    parse_floorplan,
    save_floorplan,
    shipped_scenes,
)
from raytrace.plan.random_plans import random_plan
from raytrace.propagation.plan_summary import floorplan_summary


def plan_data() -> dict[str, Any]:
    corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]]
    return {
        "format": "hapslam-floorplan",
        "version": 1,
        "name": "square",
        "walls": [
            {"name": f"w{index}", "from_m": corner, "to_m": corners[(index + 1) % 4]}
            for index, corner in enumerate(corners)
        ],
        "anchors": [{"name": "pa1", "position_m": [7.0, 6.0, 2.5]}],
        "agent": {"waypoints_m": [[2.0, 3.0], [8.0, 3.0]], "smoothing_m": 0.0, "epochs": 5},
    }


def test_plans_survive_writing(tmp_path: Path) -> None:
    """A written plan reads back with the same hash; nothing is overwritten."""
    for name in shipped_scenes():
        plan, file = load_floorplan(name), tmp_path / f"{name}.toml"
        save_floorplan(plan, file)
        assert load_floorplan(file).sha256() == plan.sha256()
        with pytest.raises(OutputExistsError):
            save_floorplan(plan, file)


def test_the_schema_accepts_what_is_read_and_refuses_the_rest() -> None:
    """Every shipped and a random plan fit; unknown keys, wrong types and missing parts do not."""
    fits = jsonschema_rs.validator_for(floorplan_schema())
    folder = Path(__file__).resolve().parents[3] / "scenes"
    for name in shipped_scenes():
        assert fits.is_valid(tomllib.loads((folder / f"{name}.toml").read_text()))
    plan = random_plan("office", np.random.default_rng(1))
    assert fits.is_valid(plan.model_dump(mode="json", exclude_none=True))
    for change in (
        {"walls": []},
        {"colour": "red"},
        {"anchors": [{"name": "pa1", "position_m": [1.0, 2.0]}]},
        {"tracing": {"depth": 9}},
        {"version": 2},
    ):
        assert not fits.is_valid(plan_data() | change), change
    assert fits.is_valid(plan_data())


def test_the_summary_measures() -> None:
    """Area, lengths and shares of a plan that can be worked out by hand."""
    summary = floorplan_summary(parse_floorplan(plan_data()))
    assert summary["area_m2"] == 80.0
    assert summary["wall_length_m"] == 36.0
    assert summary["track_m"] == 2.0
    assert summary["materials"] == {"concrete": 4}
    assert summary["line_of_sight"] == {"pa1": 1.0}
    assert summary["warnings"] == []


def test_the_summary_warns() -> None:
    """Walls on one another, ends that stop a finger short, anchors that are never seen."""
    data = plan_data()
    data["walls"] += [
        {"name": "twin", "from_m": [2.0, 0.0], "to_m": [5.0, 0.0]},
        {"name": "short", "from_m": [0.05, 5.0], "to_m": [10.0, 5.0]},
    ]
    data["anchors"].append({"name": "pa2", "position_m": [5.0, 7.0, 2.5]})
    warnings = floorplan_summary(parse_floorplan(data))["warnings"]
    assert "walls 'w0' and 'twin' lie on one another" in warnings
    assert "wall 'short' ends 0.05 m from 'w3'" in warnings
    assert "anchor 'pa2' is never in the agent's line of sight" in warnings
