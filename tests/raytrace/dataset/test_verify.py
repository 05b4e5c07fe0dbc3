"""The check of the files sees every kind of fault."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from estimator.dataset import Dataset, open_dataset
from estimator.errors import FileFormatError
from raytrace.dataset.generate import generate
from raytrace.dataset.verify import verify
from raytrace.plan.files import updated
from raytrace.plan.floorplan import FloorPlan

Change = Callable[[xr.Dataset], xr.Dataset]


@pytest.fixture
def forged(sharded: Dataset, tmp_path: Path) -> Callable[[Change], Dataset]:
    """A copy of the dataset with its third shard of paths changed, and the manifest made to agree."""

    def forge(change: Change) -> Dataset:
        room = Path(shutil.copytree(sharded.path, tmp_path / "room"))
        file = room / "paths-00002.nc"
        with xr.open_dataset(file, engine="h5netcdf") as opened:
            paths = opened.load()
        file.unlink()
        change(paths).to_netcdf(file, engine="h5netcdf")
        manifest = json.loads((room / "manifest.json").read_text())
        for entry in manifest["shards"]:
            if entry["file"] == file.name:
                entry["bytes"] = file.stat().st_size
                entry["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
        (room / "manifest.json").write_text(json.dumps(manifest))
        return open_dataset(room)

    return forge


def test_a_good_dataset_is_good(sharded: Dataset) -> None:
    """Nothing is missing, extra or wrong; files are in double precision, counts generation's."""
    told: list[tuple[int, int]] = []
    result = verify(sharded, lambda done, total, _: told.append((done, total)))
    assert result.ok
    assert (result.missing, result.extra, result.wrong, result.named) == (0, 0, 0, ())
    assert result.found == result.expected == sharded.manifest["statistics"]["passive"]["found"] > 800
    assert result.delay_error_m < 1e-9
    assert result.angle_error_deg < 1e-9
    assert result.amplitude_error_db < 1e-6
    assert told == [(10, 40), (20, 40), (30, 40), (40, 40)]


def test_a_turned_agent_is_no_fault(short_plan: FloorPlan, tmp_path: Path) -> None:
    """Arrivals in the files are in the agent's frame; the check turns them back."""
    turned = updated(short_plan, {"agent.heading_deg": 117.0, "agent.epochs": 3, "echo.sweep_epochs": [0]})
    assert verify(generate(turned, tmp_path / "room", seed=1).dataset).ok


def test_a_lost_path_is_named(forged: Callable[[Change], Dataset]) -> None:
    """Taken away from the files, a path is missing, and the report says which."""

    def lose(paths: xr.Dataset) -> xr.Dataset:
        assert paths["order"].values[4, 1, 0] == 0
        paths["path_valid"].values[4, 1, 0] = 0
        return paths

    result = verify(forged(lose))
    assert (result.missing, result.extra, result.wrong, result.ok) == (1, 0, 0, False)
    assert result.named == ({"fault": "missing", "epoch": 24, "anchor": "pa2", "surfaces": []},)


def test_an_extra_path_is_named(forged: Callable[[Change], Dataset]) -> None:
    """A path over a wall that reflects nothing there, or the same path twice, is extra."""

    def add(paths: xr.Dataset) -> xr.Dataset:
        paths["walls"].values[0, 0, 0] = [4, 1]  # the line of sight becomes a bounce over "edge"
        paths["order"].values[0, 0, 0] = 2
        for name in paths.data_vars:
            paths[name].values[1, 0, 1] = paths[name].values[1, 0, 0]
        return paths

    result = verify(forged(add))
    assert (result.missing, result.extra) == (2, 2)
    assert {(path["fault"], path["epoch"]) for path in result.named} == {
        *(("missing", 20), ("missing", 21), ("extra", 20), ("extra", 21)),
    }


@pytest.mark.parametrize(
    ("name", "shift"),
    [("delay_s", 1e-11), ("arrival_azimuth_rad", 3e-4), ("arrival_elevation_rad", np.nan)],
)
def test_a_shifted_path_is_wrong(forged: Callable[[Change], Dataset], name: str, shift: float) -> None:
    """Three millimetres, or a sixtieth of a degree, or no number at all, is more than the tracer errs."""

    def move(paths: xr.Dataset) -> xr.Dataset:
        paths[name].values[5, 0, 2] += shift
        return paths

    result = verify(forged(move))
    assert (result.missing, result.extra, result.wrong, result.ok) == (0, 0, 1, False)
    assert result.named[0]["fault"] == "wrong"
    json.dumps(result.as_dict(), allow_nan=False)


def test_a_louder_path_is_measured(forged: Callable[[Change], Dataset]) -> None:
    """A path that is a decibel too strong is wrong, and shows in the largest deviation."""

    def amplify(paths: xr.Dataset) -> xr.Dataset:
        for part in ("re", "im"):
            paths[f"amplitude_{part}"].values[5, 0, 0] *= 10 ** (1 / 20)
        return paths

    result = verify(forged(amplify))
    assert result.amplitude_error_db == pytest.approx(1.0, abs=1e-6)
    assert (result.wrong, result.named[0]["fault"]) == (1, "wrong")


def test_damage_is_an_error(sharded: Dataset, tmp_path: Path) -> None:
    """A changed byte, missing epochs, and another plan in the truth are told apart from lost paths."""
    room = Path(shutil.copytree(sharded.path, tmp_path / "one"))
    data = bytearray((room / "passive-00001.nc").read_bytes())
    data[-1] ^= 1
    (room / "passive-00001.nc").write_bytes(data)
    with pytest.raises(FileFormatError, match="passive-00001.nc.*the shard was changed"):
        verify(open_dataset(room))
    for words, change in (
        ("expected paths from epoch 10 on", lambda m: m["shards"].pop(5)),
        ("expected paths of 40 epochs, got 30", lambda m: m["shards"].pop(-2)),
        ("expected the manifest's plan in truth.nc", lambda m: m["scene"].update(sha256="0")),
    ):
        room = Path(shutil.copytree(sharded.path, tmp_path / words.split()[-1]))
        manifest = json.loads((room / "manifest.json").read_text())
        change(manifest)
        (room / "manifest.json").write_text(json.dumps(manifest))
        with pytest.raises(FileFormatError, match=words):
            verify(open_dataset(room))
