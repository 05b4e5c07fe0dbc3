"""`hapslam simulate` and `hapslam reproduce`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from estimator.experiments.catalogue import FIGURES
from estimator.measurement_files import load_measurements

Runner = Callable[..., SimpleNamespace]


@pytest.mark.parametrize("command", ["simulate", "reproduce"])
def test_help_has_examples(main: Runner, command: str) -> None:
    """Each command explains itself, with examples that call it; the figures are listed."""
    run = main(command, "--help")
    assert run.status == 0
    assert f"$ hapslam {command}" in run.out
    assert command == "simulate" or all(name in run.out for name in FIGURES)


def test_simulated_measurements_can_be_read(main: Runner, tmp_path: Path) -> None:
    """A measurement file with walls, epochs, directions and known anchors; equal seeds give equal files."""
    for name in ("one.nc", "two.nc"):
        run = main(
            "simulate", "l-room", "--out", tmp_path / name, "--seed", 3, "--with", "aoa", "--know-anchors"
        )
        assert run.status == 0, run.err
    measured = load_measurements(tmp_path / "one.nc")
    assert len(measured.epochs) == 236
    assert [round(float(np.linalg.norm(wall.mean_m)), -1) for wall in measured.walls] == [20, 50, 140, 30]
    assert measured.epochs[0].paths[0].azimuth_rad is not None
    assert measured.known_anchors_m is not None
    np.testing.assert_allclose(measured.known_anchors_m, [[58.0, -9.0], [32.0, 21.0]])
    assert (tmp_path / "one.nc").read_bytes() == (tmp_path / "two.nc").read_bytes()
    again = main("simulate", "l-room", "--out", tmp_path / "one.nc")
    assert again.status == 2
    assert "exists" in again.err


def test_a_figure_is_reproduced_as_json(main: Runner, tmp_path: Path) -> None:
    """`reproduce fig13 --json` prints one object with a key for each method and engine; files are left."""
    run = main(
        "reproduce", "fig13", "--runs", 1, "--methods", "hybrid", "--engine", "gaussian",
        "--out", tmp_path / "out", "--json",
    )  # fmt: skip
    assert run.status == 0, run.err
    printed = json.loads(run.out)
    assert list(printed) == ["hybrid/gaussian"]
    assert printed["hybrid/gaussian"]["limit"]["mae_final_m"] == pytest.approx(0.38, abs=0.01)
    left = json.loads((tmp_path / "out" / "fig13.json").read_text(encoding="utf-8"))
    assert left["summary"] == printed
    text = (tmp_path / "out" / "fig13.txt").read_text(encoding="utf-8")
    assert "paper" in text
    assert {path.suffix for path in (tmp_path / "out").iterdir()} == {".png", ".svg", ".json", ".txt"}


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["fig6"], "fig7"),
        (["fig13", "--methods", "psychic"], "hybrid"),
        (["fig9", "--engine", "gaussian"], "fig9"),
        (["fig9", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "jobs"),
    ],
)
def test_what_does_not_exist_is_refused(
    main: Runner, tmp_path: Path, arguments: list[str], word: str
) -> None:
    """Unknown figures and methods, and options without meaning: one line, status 2, no files."""
    run = main("reproduce", *arguments, "--out", tmp_path / "out", "--quiet")
    assert run.status == 2
    assert word in run.err
    assert not (tmp_path / "out").exists()


def test_nothing_is_computed_if_the_place_is_taken(main: Runner, tmp_path: Path) -> None:
    """A file of the figure in the folder is an error before the first run."""
    (tmp_path / "fig13.svg").write_text("mine", encoding="utf-8")
    run = main("reproduce", "fig13", "--out", tmp_path, "--quiet")
    assert run.status == 2
    assert "fig13.svg" in run.err
    assert (tmp_path / "fig13.svg").read_text(encoding="utf-8") == "mine"


def test_ranges_of_others_are_converted(main: Runner, tmp_path: Path) -> None:
    """`convert` makes a file that `slam` reads; a place that is none is named, and files are not replaced."""
    measured = tmp_path / "sim.nc"
    assert main("simulate", "l-room", "--out", measured, "--seed", 3, "--know-anchors").status == 0
    epochs = load_measurements(measured).epochs[:30]
    cells = [paths.range_m for epoch in epochs for paths in epoch.paths]
    offsets = np.concatenate([[0], np.cumsum([len(cell) for cell in cells])])
    np.savez(tmp_path / "ranges.npz", range_m=np.concatenate(cells), offsets=offsets)
    wanted = ("convert", tmp_path / "ranges.npz", "--known-anchors", "68,6", "--known-anchors", "42,36")
    wanted = (*wanted, "--start", "10,15", "--range-std", 0.1, "--out", tmp_path / "ranges.nc")
    assert main(*wanted).status == 0
    slam = main("slam", tmp_path / "ranges.nc", "--method", "mva", "--out", tmp_path / "map.nc")
    assert slam.status == 0, slam.err
    assert "exists" in main(*wanted).err
    wrong = main(*wanted[:2], "--known-anchors", "68;6", "--range-std", 0.1, "--out", tmp_path / "other.nc")
    assert wrong.status == 2
    assert "--known-anchors: expected two numbers X,Y, got '68;6'" in wrong.err
    assert not (tmp_path / "other.nc").exists()
