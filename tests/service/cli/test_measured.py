"""Measurements of others on the command line: from a log to a map, and against a true track."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from estimator.measurement_files import load_measurements

Runner = Callable[..., SimpleNamespace]
PLACES = {"north": (2.0, 9.0), "east": (9.0, 3.0), "south": (4.0, -5.0), "west": (-6.0, 2.0)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Ranges with a bias of 0.3 m, anchors in turn; the anchors; the true track."""
    rng = np.random.default_rng(8)
    time = 0.1 * np.arange(1, 401)
    track = np.stack([2.0 + 2.5 * np.cos(0.2 * time), 1.0 + 2.0 * np.sin(0.2 * time)], axis=1)
    lines = ["time,anchor,range_m"]
    for n, t in enumerate(time):
        name = list(PLACES)[n % 4]
        length = np.linalg.norm(track[n] - PLACES[name]) + 0.3 + 0.05 * rng.normal()
        lines.append(f"{1000.0 + t:.3f},{name},{length:.3f}")
    (tmp_path / "ranges.csv").write_text("\n".join(lines) + "\n")
    rows = [f"{name},{x},{y}" for name, (x, y) in PLACES.items()]
    (tmp_path / "anchors.csv").write_text("\n".join(["anchor,x,y", *rows]) + "\n")
    truth = [f"{1000.0 + t} {x} {y} 0 0 0 0 1" for t, (x, y) in zip(time, track, strict=True)]
    (tmp_path / "truth.txt").write_text("\n".join(truth) + "\n")
    return tmp_path


def test_from_a_log_to_a_map_and_its_error(main: Runner, folder: Path) -> None:
    """Convert, run, compare, export: the bias is found, and the error is honest."""
    made = main(
        *("convert", folder / "ranges.csv", "--anchors", folder / "anchors.csv"),
        *("--out", folder / "ranges.nc", "--describe"),
    )
    assert made.status == 0, made.err
    assert "anchor east: asked 100 times, heard 100 times" in made.out
    assert "clock_bias_std_m=0.2" in made.out
    measured = load_measurements(folder / "ranges.nc")
    assert measured.epochs[1].asked == (False, True, False, False)
    assert main("slam", folder / "ranges.nc", "--method", "va", "--out", folder / "map.nc").status == 0
    told = main("evaluate", folder / "map.nc", "--truth-track", folder / "truth.txt", "--json")
    assert told.status == 0, told.err
    numbers = json.loads(told.out)
    assert numbers["epochs"] == 400
    assert numbers["position_mae_m"] < 0.15
    assert 0.2 < numbers["nees_position_per_dim"] < 3.0
    text = main(
        *("evaluate", folder / "map.nc", "--truth-track", folder / "truth.txt", "--align", "se2"),
        *("--truth-anchors", folder / "anchors.csv"),
    )
    assert "aligned: se2" in text.out
    track = folder / "track.txt"
    assert main("export", folder / "map.nc", "--to", "tum", "--out", track).status == 0
    again = main("evaluate", folder / "map.nc", "--truth-track", track, "--json")
    assert json.loads(again.out)["position_mae_m"] == pytest.approx(0.0, abs=1e-9)


def test_mistakes_are_told(main: Runner, folder: Path) -> None:
    """One line each, status 2, no file made."""
    ranges, out = folder / "ranges.csv", ("--out", folder / "o.nc")
    (folder / "ranges.dat").write_text("x")
    for arguments, words in (
        ((ranges,), "anchors_m: expected a place (x, y) of each of north, east, south, west, got none"),
        ((ranges, "--known-anchors", "1,2"), "got shape (1, 2)"),
        ((ranges, "--known-anchors", "a=1,2", "--known-anchors", "3,4"), "names of all anchors or of none"),
        ((ranges, "--known-anchors", "1,2", "--anchors", folder / "anchors.csv"), "one of them, got both"),
        ((ranges, "--known-anchors", "far=1,2"), "expected anchors among far, got 'north'"),
        ((folder / "ranges.dat",), "--format: expected one of"),
        (
            (ranges, "--anchors", folder / "anchors.csv", "--range-std", -1),
            "range_std_m: expected a positive",
        ),
    ):
        run = main("convert", *arguments, *out)
        assert run.status == 2
        assert words in run.err
    assert not (folder / "o.nc").exists()
    run = main("reproduce", "measured")
    assert run.status == 2
    assert "--data: expected the folder of the measured sets" in run.err
    assert "--out: expected a folder" in main("reproduce", "fig9").err
