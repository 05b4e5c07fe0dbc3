"""`slam --floor-plan`: walls of plans and drawings, in the frame of the run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import MeasurementSet
from estimator.result import load_result

Runner = Callable[..., SimpleNamespace]
CORNERS = [[0, 0], [80, 0], [80, 60], [50, 60], [50, 40], [0, 40], [0, 0]]  # of the l-room
VRPS = np.array([[-20.0, 0.0], [0.0, 50.0], [140.0, 0.0], [0.0, -30.0]])  # of its walls in view of the start


@pytest.fixture
def simulated(main: Runner, tmp_path: Path) -> Path:
    """Ten epochs in the l-room, anchors known."""
    whole, short = tmp_path / "whole.nc", tmp_path / "short.nc"
    assert main("simulate", "l-room", "--know-anchors", "--out", whole).status == 0
    found = load_measurements(whole)
    kept = MeasurementSet(
        found.anchors,
        found.walls,
        found.epochs[:10],
        found.carrier_hz,
        found.settings,
        known_anchors_m=found.known_anchors_m,
    )
    save_measurements(kept, short)
    return short


def drawing(folder: Path) -> Path:
    """The room as GeoJSON, in metres."""
    path = folder / "room.geojson"
    line = {"type": "LineString", "coordinates": CORNERS}
    path.write_text(
        json.dumps(
            {
                "type": "FeatureCollection",
                "features": [{"type": "Feature", "properties": {}, "geometry": line}],
            }
        )
    )
    return path


@pytest.mark.parametrize("method", ["hybrid", "mva"])
def test_a_shipped_scene(main: Runner, simulated: Path, tmp_path: Path, method: str) -> None:
    """The plan says where its agent starts; all six walls are there, where they are."""
    out = tmp_path / "map.nc"
    made = main("slam", simulated, "--floor-plan", "l-room", "--method", method, "--out", out, "--quiet")
    assert made.status == 0, made.err
    walls = load_result(out).wall_mean_m[0]
    assert len(walls) == 6
    assert np.linalg.norm(walls[:, None] - VRPS, axis=-1).min(axis=0).max() < 0.2


def test_a_drawing(main: Runner, simulated: Path, tmp_path: Path) -> None:
    """A drawing does not say where the run starts: it has to be told, and its axes may be turned."""
    plan, out = drawing(tmp_path), tmp_path / "map.nc"
    lacking = main("slam", simulated, "--floor-plan", plan, "--out", out)
    assert lacking.status == 2
    assert "--start: expected X,Y in the floor plan" in lacking.err
    made = main(
        "slam", simulated, "--floor-plan", plan, "--start", "10,15", "--out", out, "--plan-std", "0.02"
    )
    assert made.status == 0, made.err
    found = load_result(out)
    assert np.linalg.norm(found.wall_mean_m[0][:, None] - VRPS, axis=-1).min(axis=0).max() < 0.2


def test_refusals(main: Runner, simulated: Path, tmp_path: Path) -> None:
    """Virtual anchors, options without a plan, no point, no plan."""
    out = ("--out", tmp_path / "map.nc")
    for options, words in (
        (("--floor-plan", "l-room", "--method", "va"), "hybrid, mva, active take them"),
        (("--start", "1,2"), "expected with --floor-plan alone"),
        (("--floor-plan", "l-room", "--start", "here"), "--start: expected two numbers X,Y, got 'here'"),
        (("--floor-plan", "no-such-scene"), "no-such-scene"),
    ):
        run = main("slam", simulated, *options, *out)
        assert run.status == 2
        assert words in run.err
    assert not (tmp_path / "map.nc").exists()
