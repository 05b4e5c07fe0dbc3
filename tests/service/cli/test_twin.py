"""The commands of twins, from files to a plan, to predictions and to figures of merit."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from estimator.measurement_files import save_measurements
from estimator.result import save_result
from raytrace.dataset.generate import generate
from raytrace.plan.files import load_floorplan, updated
from tests.mapped_runs import mapped_run

MAPPED = ["west", "south", "east", "north-right", "north-left"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Result, measurements, the dataset that was mapped (three epochs of it), and another walk."""
    path = tmp_path_factory.mktemp("twin")
    plan = updated(load_floorplan("l-room"), {"tracing.engine": "images", "radio.subcarriers": 64})
    result, measurements = mapped_run(plan, np.random.default_rng(1), 2, MAPPED)
    save_result(replace(result, dataset="mapped"), path / "result.nc")
    save_measurements(measurements, path / "measurements.nc")
    generate(updated(plan, {"agent.epochs": 3}), path / "mapped", 1)
    other = {"agent.waypoints_m": [[60, 20], [20, 30], [12, 22]], "agent.epochs": 30, "agent.step_m": 1.5}
    generate(updated(plan, other), path / "other", 1)
    (path / "walk.csv").write_text("time,x,y\n0,1,2\n1,2,3\n", encoding="utf-8")
    return path


def test_a_map_becomes_a_plan_that_predicts(main, folder, tmp_path):
    """The plan loads, says how sure it is, and is far better than interpolation on another walk."""
    out = tmp_path / "twin.toml"
    done = main(
        "twin",
        folder / "result.nc",
        "--measurements",
        folder / "measurements.nc",
        "--out",
        out,
        "--score",
        folder / "other",
        "--json",
    )
    assert done.status == 0, done.err
    facts = json.loads(done.out)
    assert (facts["walls"], facts["assumed_walls"], facts["open_ends"]) == (5, 1, 0)
    score = facts["score"]
    assert score["far_share"] > 0.5
    assert score["twin"]["explained"] > 0.98
    assert score["twin"]["invented"] < 0.02
    assert score["twin"]["power_db"][1] < 0.6
    assert score["ends_m"]["largest"] < 0.2
    best = min(told["power_db"][1] for told in score["interpolations"].values())
    assert score["twin"]["power_db"][1] < 0.5 * best
    assert score["true_plan"]["power_db"][1] < 1e-9
    plan = load_floorplan(out)
    assert {wall.material for wall in plan.walls} == {"concrete"}
    assert plan.uncertainty.walls[-1].assumed
    table = tomllib.loads(out.read_text())["uncertainty"]
    assert table["rotation_std_rad"] == pytest.approx(1e-3)


def test_scores_are_told_in_words(main, folder, tmp_path):
    """Without --json a line for each."""
    done = main(
        "twin",
        folder / "result.nc",
        "--measurements",
        folder / "measurements.nc",
        "--out",
        tmp_path / "twin.toml",
        "--score",
        folder / "other",
        "--picture",
        tmp_path / "coverage.png",
    )
    assert done.status == 0, done.err
    assert (tmp_path / "coverage.png").stat().st_size > 10_000
    for words in ("assumed walls        1", "nearest neighbour", "line of sight right 1.000", "wall ends"):
        assert words in done.out


def test_predictions_are_rows_or_a_file(main, folder, tmp_path):
    """On the standard output a table; in a file the paths, too."""
    done = main("predict", "l-room", "--at", folder / "walk.csv")
    assert done.status == 0, done.err
    head, *rows = done.out.splitlines()
    assert head.startswith("time_s,x_m,y_m,anchor,paths,power_db")
    assert len(rows) == 4
    assert main("predict", "l-room", "--at", folder / "walk.csv", "--out", tmp_path / "walk.json").status == 0
    told = json.loads((tmp_path / "walk.json").read_text())
    assert len(told["paths"]) == sum(row["paths"] for row in told["channels"])


def test_what_does_not_fit_is_refused(main, folder, tmp_path):
    """Names that are taken, and measurements of another run, in one line."""
    taken = tmp_path / "twin.toml"
    taken.write_text("")
    options = "--measurements", folder / "measurements.nc", "--out"
    done = main("twin", folder / "result.nc", *options, taken)
    assert done.status == 2
    assert "expected a name that is free" in done.err
    done = main("twin", folder / "measurements.nc", *options, tmp_path / "new.toml")
    assert done.status == 2
    assert "expected format 'hapslam-result'" in done.err
    assert not (tmp_path / "new.toml").exists()
