"""Extraction and SLAM broken off at any moment go on, and end with the bytes of a run that was not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import estimator.slam.run
from estimator.errors import FileFormatError, OutputExistsError
from estimator.measurement_files import load_measurements
from estimator.parts import Parts
from estimator.pipeline import extract_file, slam_file
from estimator.slam import run_slam
from raytrace.dataset.generate import generate
from raytrace.dataset.output import Output
from raytrace.plan.files import load_floorplan, updated

ROOT = Path(__file__).resolve().parents[2]
Folder = Path

_STAGES = {
    "extract": "extract_file(a / 'room', b, resume=True, period_s=0.0)",
    "slam": "slam_file(a / 'm.nc', b, resume=True, period_s=0.0)",
}


class Broken(Exception):
    """Where a run is broken off."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """A traced walk with sweeps, its measurements and its result, made without a break."""
    changes = {"agent.epochs": 36, "echo.sweep_epochs": [0, 12, 30], "tracing.engine": "images"}
    folder = tmp_path_factory.mktemp("whole")
    generate(updated(load_floorplan("l-room"), changes), folder / "room", 1, output=Output(shard_epochs=4))
    extract_file(folder / "room", folder / "m.nc")
    slam_file(folder / "m.nc", folder / "r.nc")
    assert sorted(path.name for path in folder.iterdir()) == ["m.nc", "r.nc", "r.nc.run.json", "room"]
    return folder


def breaking_at(step: int) -> Callable[..., None]:
    """Progress that breaks off when it is called so many times."""
    calls = iter(range(step + 1))

    def advance(*_: object) -> None:
        if next(calls) == step:
            raise Broken

    return advance


def run(stage: str, folder: Folder, out: Path, step: int | None, resume: bool = True) -> bool:
    """Run a stage that keeps what it has done all the time; whether it came to its end."""
    progress = None if step is None else breaking_at(step)
    try:
        if stage == "extract":
            extract_file(folder / "room", out, progress, resume, period_s=0.0)
        else:
            slam_file(folder / "m.nc", out, progress=progress, resume=resume, period_s=0.0)
    except Broken:
        return False
    return True


@pytest.mark.parametrize(("stage", "name"), [("extract", "m.nc"), ("slam", "r.nc")])
def test_a_run_broken_off_goes_on_to_the_same_bytes(whole: Folder, stage: str, name: str) -> None:
    """Broken off again and again, it goes on each time from where it was, and leaves no part behind."""
    out, breaks = whole / f"broken-{name}", 0  # files name their dataset relative to their folder
    while not run(stage, whole, out, 2 if breaks < 4 else None):
        breaks += 1
        assert not out.exists()
        assert any(out.with_name(f"{out.name}.parts").iterdir())
    assert breaks == 4
    assert out.read_bytes() == (whole / name).read_bytes()
    assert not out.with_name(f"{out.name}.parts").exists()


def test_a_run_killed_at_its_very_end_is_done(whole: Folder, tmp_path: Path) -> None:
    """The file is there and the parts are still: going on clears them away and changes nothing."""
    for stage, name in (("extract", "m.nc"), ("slam", "r.nc")):
        out = tmp_path / name
        run(stage, whole, out, 3)
        out.write_bytes(b"whole")
        assert run(stage, whole, out, None)
        assert out.read_bytes() == b"whole"
        assert not out.with_name(f"{name}.parts").exists()


def test_stretches_do_not_show_in_a_result(whole: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimates stacked seven by seven and joined are those stacked at once."""
    measured = load_measurements(whole / "m.nc")
    at_once = run_slam(measured)
    monkeypatch.setattr(estimator.slam.run, "_STRETCH", 7)
    joined = run_slam(measured)
    for name, value in vars(at_once).items():
        np.testing.assert_array_equal(value, getattr(joined, name), err_msg=name)
        if isinstance(value, np.ndarray):
            assert value.dtype == getattr(joined, name).dtype, name


def test_parts_are_not_taken_up_unasked(whole: Folder, tmp_path: Path) -> None:
    """What an interrupted run left is neither overwritten nor used without a word."""
    out = tmp_path / "r.nc"
    run("slam", whole, out, 3)
    before = sorted(path.name for path in (tmp_path / "r.nc.parts").iterdir())
    with pytest.raises(
        OutputExistsError, match=r"an interrupted run left .*r\.nc\.parts; go on with it by --resume"
    ):
        run("slam", whole, out, None, resume=False)
    assert sorted(path.name for path in (tmp_path / "r.nc.parts").iterdir()) == before


def test_parts_of_other_work_are_refused(whole: Folder, tmp_path: Path) -> None:
    """Another seed or other measurements: the parts are of no use, and the error says in what they differ."""
    out = tmp_path / "r.nc"
    run("slam", whole, out, 3)
    with pytest.raises(FileFormatError, match="expected parts of the same work, got others in slam; remove"):
        slam_file(whole / "m.nc", out, seed=2, resume=True)
    for rubbish in ("[", "[]"):
        (tmp_path / "r.nc.parts" / "work.json").write_text(rubbish)
        with pytest.raises(FileFormatError, match=r"work\.json: expected a JSON object"):
            run("slam", whole, out, None)
    (tmp_path / "r.nc.parts" / "work.json").unlink()
    with pytest.raises(FileFormatError, match=r"expected work\.json beside the parts, it is missing"):
        run("slam", whole, out, None)


def test_damage_to_a_part_is_named(whole: Folder, tmp_path: Path) -> None:
    """A part cut short, or without its state, ends the run with its name."""
    out = tmp_path / "r.nc"
    run("slam", whole, out, 3)
    (state,) = (tmp_path / "r.nc.parts").glob("*.state")
    kept = state.read_bytes()
    state.unlink()
    with pytest.raises(FileFormatError, match=r"slam-000000004\.state: expected the state at step 4"):
        run("slam", whole, out, None)
    state.write_bytes(kept[:100])
    with pytest.raises(FileFormatError, match="state: expected"):
        run("slam", whole, out, None)
    state.write_bytes(kept)
    part = max((tmp_path / "r.nc.parts").glob("slam-*.nc"))
    part.write_bytes(part.read_bytes()[:1000])
    with pytest.raises(FileFormatError, match=part.name):
        run("slam", whole, out, None)


def test_a_folder_without_parts_is_begun_anew(whole: Folder, tmp_path: Path) -> None:
    """Killed before anything was kept, a run begins; half-written files are cleared away."""
    folder = tmp_path / "r.nc.parts"
    folder.mkdir()
    (folder / ".work.json.4711.tmp").write_text("{")
    assert run("slam", whole, tmp_path / "r.nc", None)
    assert not folder.exists()


def test_short_runs_keep_nothing(tmp_path: Path) -> None:
    """A part is due when the last one is old enough, not before."""
    assert not Parts(tmp_path / "r.nc", {}, period_s=60.0).due
    assert Parts(tmp_path / "r.nc", {}, period_s=0.0).due
    assert not (tmp_path / "r.nc.parts").exists()


def killed(stage: str, whole: Folder, out: Path, rng: np.random.Generator) -> bool:
    """Start or go on with a stage and kill it at a random moment; False if it ended before."""
    imports = "from pathlib import Path; from estimator.pipeline import extract_file, slam_file"
    program = f"{imports}; a, b = Path({str(whole)!r}), Path({str(out)!r}); {_STAGES[stage]}"
    folder = out.with_name(f"{out.name}.parts")
    before = set(folder.iterdir()) if folder.exists() else set()
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    while process.poll() is None:  # until this run has kept something
        time.sleep(0.005)
        if folder.exists() and set(folder.iterdir()) - before:
            break
    time.sleep(rng.uniform(0.0, 0.3))
    process.send_signal(signal.SIGKILL)
    _, said = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), said
    return process.returncode != 0 and not (out.exists() and not folder.exists())


def kills(stage: str, name: str, whole: Folder, count: int) -> None:
    """Kill a stage so many times, and hold what each run ended in against the run that was not killed."""
    rng, done, tries = np.random.default_rng(7), 0, 0
    while done < count:
        tries += 1
        out = whole / f"killed-{count}-{tries}-{name}"
        while done < count and killed(stage, whole, out, rng):
            done += 1
        run(stage, whole, out, None) if out.with_name(f"{out.name}.parts").exists() else None
        assert out.read_bytes() == (whole / name).read_bytes(), f"after {done} kills"
        if stage == "slam":
            assert json.loads(out.with_name(f"{out.name}.run.json").read_text())["method"] == "hybrid"


def test_killed_by_the_system(whole: Folder) -> None:
    """SIGKILL at a random moment of each stage, then on to the same bytes."""
    kills("extract", "m.nc", whole, 1)
    kills("slam", "r.nc", whole, 1)


@pytest.mark.soak
def test_killed_ten_times(whole: Folder) -> None:
    """The same ten times each."""
    kills("extract", "m.nc", whole, 10)
    kills("slam", "r.nc", whole, 10)
