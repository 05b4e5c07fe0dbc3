"""Datasets that grow, and datasets that are put together."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimator.dataset import Dataset, open_dataset
from estimator.errors import ConfigurationError, FileFormatError, OutputExistsError
from raytrace.dataset.append import append
from raytrace.dataset.generate import generate, generate_part
from raytrace.dataset.merge import merge
from raytrace.dataset.output import Output
from raytrace.plan.files import FloorPlanError, updated
from raytrace.plan.floorplan import FloorPlan

Digests = Callable[[Path], dict[str, str]]


@pytest.fixture(scope="module")
def longer(sharded: Dataset, short_plan: FloorPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short walk, appended to 63 epochs."""
    room = Path(shutil.copytree(sharded.path, tmp_path_factory.mktemp("longer") / "room"))
    append(room, 63)
    return room


def test_appending_adds_shards_and_keeps_those_there(
    longer: Path, sharded: Dataset, digests: Digests
) -> None:
    """The old shards keep their bytes; new ones follow, to the end of the longer walk."""
    before, after = digests(sharded.path), digests(longer)
    shards = [name for name in before if name[-4] in "0123456789"]
    assert len(shards) == 11
    assert all(after[name] == before[name] for name in shards)
    dataset = open_dataset(longer)
    epochs = np.concatenate([shard["epoch"].values for shard in dataset.shards("passive")])
    np.testing.assert_array_equal(epochs, np.arange(63))
    assert dataset.manifest["output"]["joints"] == [40]
    assert dataset.truth().sizes["epoch"] == 63


def test_appending_is_a_configuration(
    longer: Path, short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """Generated at once with a joint at epoch 40, the dataset has the same bytes."""
    plan = updated(short_plan, {"agent.epochs": 63})
    generate(plan, tmp_path / "room", 1, output=replace(cut, joints=(40,)))
    assert digests(tmp_path / "room") == digests(longer)


def test_appending_goes_on(longer: Path, sharded: Dataset, tmp_path: Path, digests: Digests) -> None:
    """Broken off after one new shard, appending again ends in the same; once more changes nothing."""
    room = Path(shutil.copytree(longer, tmp_path / "room"))
    manifest = json.loads((room / "manifest.json").read_text())
    manifest["shards"] = [entry for entry in manifest["shards"] if entry.get("epochs", [99])[0] < 50]
    manifest["complete"] = False
    del manifest["statistics"]
    (room / "manifest.json").write_text(json.dumps(manifest))
    shutil.copy(sharded.path / "truth.nc", room / "truth.nc")  # not yet replaced
    for _ in range(2):
        append(room, 63)
        assert digests(room) == digests(longer)


def test_what_cannot_be_appended(longer: Path, tmp_path: Path, digests: Digests) -> None:
    """Fewer epochs, way-points that end, other versions and broken generations are refused, and harmless."""
    before = digests(longer)
    with pytest.raises(ConfigurationError, match="expected more than the 63"):
        append(longer, 50)
    with pytest.raises(FloorPlanError, match="expected at most"):
        append(longer, 5000)
    assert digests(longer) == before
    for change, words in (
        ({"versions": {"sionna-rt": "0.1"}}, "differs in versions"),
        ({"complete": False, "output": {"joints": []}}, "it was broken off on the way to 63 epochs"),
    ):
        room = Path(shutil.copytree(longer, tmp_path / words.split()[0]))
        manifest = json.loads((room / "manifest.json").read_text())
        (room / "manifest.json").write_text(json.dumps({**manifest, **change}))
        with pytest.raises(ConfigurationError, match=words):
            append(room, 80)


@pytest.fixture(scope="module")
def parts(short_plan: FloorPlan, cut: Output, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The short walk in three parts."""
    folder = tmp_path_factory.mktemp("parts")
    for number in (1, 2, 3):
        generate_part(short_plan, folder / str(number), 1, (number, 3), output=cut)
    return [folder / str(number) for number in (1, 2, 3)]


def test_parts_make_the_whole(
    parts: list[Path], sharded: Dataset, short_plan: FloorPlan, tmp_path: Path, digests: Digests
) -> None:
    """Parts are incomplete; together, in any order, they have the bytes of a dataset made at once."""
    for part in parts:
        with pytest.raises(FileFormatError, match="expected a complete dataset"):
            open_dataset(part)
    merged = merge(short_plan, [parts[2], parts[0], parts[1], parts[0]], tmp_path / "room")
    assert digests(merged.path) == digests(sharded.path)


def test_a_part_goes_on_to_the_whole(
    parts: list[Path], sharded: Dataset, short_plan: FloorPlan, cut: Output, tmp_path: Path, digests: Digests
) -> None:
    """A part can be gone on with like any dataset that was broken off."""
    room = Path(shutil.copytree(parts[1], tmp_path / "room"))
    generate(short_plan, room, 1, output=cut, resume=True)
    assert digests(room) == digests(sharded.path)


def test_what_cannot_be_merged(parts: list[Path], short_plan: FloorPlan, cut: Output, tmp_path: Path) -> None:
    """Missing shards, other seeds, another plan, a place that is taken: each is told, nothing is written."""
    generate_part(short_plan, tmp_path / "other", 2, (1, 4), output=cut)
    moved = updated(short_plan, {"agent.height_m": 1.2})
    for plan, given, words in (
        (short_plan, parts[:2], "1 are in none of them, such as that of epochs 20 to 29"),
        (short_plan, [parts[0], tmp_path / "other"], "it differs in seed"),
        (moved, parts, "it differs in scene"),
        (short_plan, [], "expected at least one dataset"),
    ):
        with pytest.raises((ConfigurationError, FileFormatError), match=words):
            merge(plan, given, tmp_path / "room")
        assert not (tmp_path / "room").exists()
    with pytest.raises(OutputExistsError):
        merge(short_plan, parts, parts[0])
    with pytest.raises(ConfigurationError, match="part: expected i/n with 1 <= i <= n, got 4/3"):
        generate_part(short_plan, tmp_path / "room", 1, (4, 3), output=cut)
