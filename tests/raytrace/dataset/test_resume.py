"""Broken off at any moment, a generation goes on and ends with the bytes of one that was not."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from estimator.dataset import Dataset, open_dataset
from estimator.errors import ConfigurationError, FileFormatError, OutputExistsError
from raytrace.dataset.generate import generate
from raytrace.dataset.journal import claimed
from raytrace.dataset.output import Output
from raytrace.plan.files import updated
from raytrace.plan.floorplan import FloorPlan

ROOT = Path(__file__).resolve().parents[3]
Digests = Callable[[Path], dict[str, str]]


def rewrite(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Edit the manifest of a dataset in place, as its writer writes it."""
    manifest = json.loads((folder / "manifest.json").read_text())
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")


def incomplete(manifest: dict[str, Any], shards: int) -> None:
    """A manifest after so many shards."""
    epochs = sorted({tuple(entry["epochs"]) for entry in manifest["shards"] if "epochs" in entry})[:shards]
    manifest["shards"] = [e for e in manifest["shards"] if tuple(e.get("epochs", ())) in epochs]
    manifest["complete"] = False
    manifest.pop("statistics")


def after_the_folder(folder: Path) -> None:
    """Killed when only the folder was there, and the manifest under its temporary name."""
    for file in folder.iterdir():
        file.unlink()
    (folder / ".manifest.json.4711.tmp").write_text("{")


def within_a_shard(folder: Path) -> None:
    """Killed when one file of the third shard was there, another half, and the fourth not at all."""
    rewrite(folder, lambda manifest: incomplete(manifest, 2))
    for name in ("truth.nc", "CARD.md", "passive-00003.nc", "paths-00003.nc", "echo-00003.nc"):
        (folder / name).unlink()
    half = (folder / "paths-00002.nc").read_bytes()[:1000]
    (folder / "paths-00002.nc").unlink()
    (folder / ".paths-00002.nc.4711.tmp").write_bytes(half)


def between_file_and_manifest(folder: Path) -> None:
    """Killed when the files of the second and fourth shard were there, and the manifest knew nothing."""

    def forget(manifest: dict[str, Any]) -> None:
        incomplete(manifest, 4)
        manifest["shards"] = [entry for entry in manifest["shards"] if entry["epochs"] in ([0, 10], [20, 30])]

    rewrite(folder, forget)
    (folder / "truth.nc").unlink()
    (folder / "CARD.md").unlink()


def before_the_end(folder: Path) -> None:
    """Killed when truth and card were there and the manifest was not complete."""
    rewrite(folder, lambda manifest: incomplete(manifest, 4))


def a_file_lost(folder: Path) -> None:
    """Broken off, and then a file of a shard that was done got lost and another was cut."""
    rewrite(folder, lambda manifest: incomplete(manifest, 4))
    (folder / "echo-00001.nc").unlink()
    os.truncate(folder / "paths-00003.nc", 100)


@pytest.mark.parametrize(
    "broken",
    [after_the_folder, within_a_shard, between_file_and_manifest, before_the_end, a_file_lost],
)
def test_every_state_that_a_kill_leaves(
    broken: Callable[[Path], None],
    sharded: Dataset,
    short_plan: FloorPlan,
    cut: Output,
    tmp_path: Path,
    digests: Digests,
) -> None:
    """Whatever of the files and the manifest is there, the end is the same, and nothing else is left."""
    room = Path(shutil.copytree(sharded.path, tmp_path / "room"))
    broken(room)
    with pytest.raises(FileFormatError):
        open_dataset(room)
    generate(short_plan, room, 1, output=cut, resume=True)
    assert digests(room) == digests(sharded.path)


def test_shards_that_are_there_are_kept(
    sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path
) -> None:
    """Going on makes what is missing and touches nothing else."""
    room = Path(shutil.copytree(sharded.path, tmp_path / "room"))
    within_a_shard(room)
    before = {file.name: file.stat().st_mtime_ns for file in room.glob("*-0000[01].nc")}
    told: list[int] = []
    generate(short_plan, room, 1, lambda done, *_: told.append(done), output=cut, resume=True)
    assert told == [20, 30, 40]
    assert {name: (room / name).stat().st_mtime_ns for name in before} == before


def test_what_is_complete_is_left_alone(
    sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path
) -> None:
    """Going on with a complete dataset writes nothing and gives its report."""
    room = Path(shutil.copytree(sharded.path, tmp_path / "room"))
    before = {file.name: file.stat().st_mtime_ns for file in room.iterdir()}
    made = generate(short_plan, room, 1, output=cut, resume=True)
    assert {file.name: file.stat().st_mtime_ns for file in room.iterdir()} == before
    assert made.report.found == sharded.manifest["statistics"]["passive"]["found"]


def test_going_on_with_something_else_is_refused(
    sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """Another seed, plan or cut would mix two datasets: each is named, and nothing changes."""
    room = Path(shutil.copytree(sharded.path, tmp_path / "room"))
    within_a_shard(room)
    before = digests(room)
    louder = updated(short_plan, {"radio.eirp_dbm": 30.0})
    for plan, seed, output, words in (
        (short_plan, 2, cut, "it differs in seed"),
        (louder, 1, cut, "it differs in scene, radio"),
        (short_plan, 1, Output(shard_epochs=5, content="both"), "it differs in output"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            generate(plan, room, seed, output=output, resume=True)
    with pytest.raises(OutputExistsError) as error:
        generate(short_plan, room, 1, output=cut)
    assert "--resume goes on with it" in error.value.__notes__[0]
    assert digests(room) == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious.txt").write_text("keep")
    with pytest.raises(FileFormatError, match="found a folder of other files"):
        generate(short_plan, tmp_path / "mine", 1, output=cut, resume=True)
    assert (tmp_path / "mine" / "precious.txt").read_text() == "keep"


def test_one_process_at_a_time(
    sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """While one writes a dataset another is refused; afterwards it is free."""
    room = Path(shutil.copytree(sharded.path, tmp_path / "room"))
    before_the_end(room)
    with claimed(room), pytest.raises(OutputExistsError, match="another process is at it"):
        generate(short_plan, room, 1, output=cut, resume=True)
    generate(short_plan, room, 1, output=cut, resume=True)
    assert digests(room) == digests(sharded.path)


def _killed(plan: Path, room: Path, rng: np.random.Generator, jobs: int) -> bool:
    """Start or go on with a generation, and kill it at a random moment; False if it ended before."""
    process = subprocess.Popen(
        [
            *(
                sys.executable,
                "-c",
                "from service.cli.main import main; main()",
                "trace",
                plan,
                "--out",
                room,
            ),
            *("--shard-epochs", "2", "--resume", "--quiet", "--jobs", str(jobs)),
        ],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    seen = (room / "manifest.json").stat().st_mtime_ns if (room / "manifest.json").is_file() else None
    while process.poll() is None:  # until the first shard of this run is written
        time.sleep(0.01)
        if (room / "manifest.json").is_file() and (room / "manifest.json").stat().st_mtime_ns != seen:
            break
    time.sleep(rng.uniform(0.0, 0.6))
    process.send_signal(signal.SIGKILL)
    _, said = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), said
    return process.returncode != 0


def _kills(plan: FloorPlan, folder: Path, kills: int, seed: int, jobs: list[int], digests: Digests) -> None:
    whole = generate(plan, folder / "whole", 1, output=Output(shard_epochs=2)).dataset
    scene = folder / "plan.toml"
    scene.write_text(tomli_w.dumps(plan.model_dump(mode="json", exclude_none=True)))
    rng, done, run = np.random.default_rng(seed), 0, 0
    while done < kills:
        run += 1
        room = folder / f"broken-{run}"
        while done < kills and _killed(scene, room, rng, jobs[done % len(jobs)]):
            done += 1
        generate(plan, room, 1, output=Output(shard_epochs=2), resume=True)
        assert digests(room) == digests(whole.path), f"after {done} kills"


def test_killed_by_the_system(short_plan: FloorPlan, tmp_path: Path, digests: Digests) -> None:
    """SIGKILL at a random moment of a traced walk, then on to the same bytes."""
    changes = {"agent.epochs": 12, "echo.sweep_epochs": [0], "tracing.engine": "sionna"}
    plan = updated(short_plan, changes)
    _kills(plan, tmp_path, 1, 5, [1], digests)


@pytest.mark.soak
def test_killed_twenty_times(short_plan: FloorPlan, tmp_path: Path, digests: Digests) -> None:
    """The same twenty times on a longer walk, some of them with two workers."""
    _kills(
        updated(short_plan, {"agent.epochs": 160, "tracing.engine": "sionna"}),
        tmp_path,
        20,
        6,
        [1, 1, 2],
        digests,
    )
