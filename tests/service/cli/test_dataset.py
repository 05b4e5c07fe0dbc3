"""The commands of datasets: what they print, what they refuse, how they end."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import tomli_w

from estimator.dataset import open_dataset
from estimator.measurement_files import load_measurements
from raytrace.plan.files import load_floorplan, updated
from service.cli import main as cli

Runner = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The L-room with nine epochs, by the image method, as a file."""
    plan = updated(load_floorplan("l-room"), {"agent.epochs": 9, "tracing.engine": "images"})
    file = tmp_path_factory.mktemp("plan") / "room.toml"
    file.write_text(tomli_w.dumps(plan.model_dump(mode="json", exclude_none=True)))
    return file


@pytest.fixture(scope="module")
def made(plan_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three shards; not to be changed."""
    out = tmp_path_factory.mktemp("made") / "room"
    options = ("--shard-epochs", "3", "--licence", "CC0-1.0", "--quiet")
    with pytest.raises(SystemExit) as ended:
        cli.main(["trace", str(plan_file), "--out", str(out), *options])
    assert not ended.value.code
    return out


@pytest.fixture
def traced(made: Path, tmp_path: Path) -> Path:
    """A copy of that dataset."""
    return Path(shutil.copytree(made, tmp_path / "room"))


def files(folder: Path) -> dict[str, str]:
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}


def test_parts_and_their_merger(main: Runner, plan_file: Path, traced: Path, tmp_path: Path) -> None:
    """`trace --part`, told to go on, and `merge` give the bytes of `trace`."""
    common = ("--shard-epochs", 3, "--licence", "CC0-1.0", "--quiet", "--resume")
    for number in (1, 2):
        for _ in range(2):
            run = main("trace", plan_file, "--out", tmp_path / str(number), "--part", f"{number}/2", *common)
            assert run.status == 0, run.err
    run = main("info", tmp_path / "2")
    assert "incomplete: hapslam trace --resume goes on with it" in run.out
    assert "3 of 9" in run.out
    run = main("merge", plan_file, tmp_path / "1", tmp_path / "2", "--out", tmp_path / "whole")
    assert run.status == 0, run.err
    assert files(tmp_path / "whole") == files(traced)


def test_the_data_card(traced: Path) -> None:
    """What, how, licence, versions and statistics are on it; places of walls and anchors are not."""
    card = (traced / "CARD.md").read_text()
    manifest = open_dataset(traced).manifest
    found = manifest["statistics"]["passive"]["found"]
    for words in (
        "# l-room",
        manifest["scene"]["sha256"],
        "CC0-1.0",
        f"numpy {manifest['versions']['numpy']}",
        "28 GHz",
        "9, in shards of at most 3",
        f"| passive | {found} | {found} | 0 | 0 | 0 |",
    ):
        assert words in card
    assert "68.0" not in card
    assert "west" not in card


def test_info(main: Runner, traced: Path) -> None:
    """A table for people, one object for programs, and status 1 if a file is damaged."""
    run = main("info", traced)
    assert run.status == 0
    assert "complete" in run.out
    assert "9 of 9, anchors pa1, pa2" in run.out
    facts = json.loads(main("info", traced, "--json").out)
    assert (facts["complete"], facts["epochs_there"], facts["files"]) == (True, 9, 8)
    assert facts["bytes"] == sum(file.stat().st_size for file in traced.glob("*.nc"))
    assert facts["damaged"] == []
    (traced / "paths-00001.nc").write_bytes(b"")
    run = main("info", traced, "--json")
    assert run.status == 1
    assert json.loads(run.out)["damaged"] == ["paths-00001.nc"]


def test_verify(main: Runner, traced: Path, tmp_path: Path) -> None:
    """Status 0 for a good dataset, 1 when a path is lost, 2 when files are damaged."""
    run = main("verify", traced, "--quiet")
    assert run.status == 0
    assert "0 missing, 0 extra, 0 wrong" in run.out
    assert json.loads(main("verify", traced, "--json", "--quiet").out)["ok"] is True

    import xarray as xr

    file = traced / "paths-00001.nc"
    with xr.open_dataset(file, engine="h5netcdf") as opened:
        paths = opened.load()
    paths["path_valid"].values[0, 0, 3] = 0
    file.unlink()
    paths.to_netcdf(file, engine="h5netcdf")
    run = main("verify", traced, "--quiet")
    assert run.status == 2
    assert "paths-00001.nc: expected" in run.err
    manifest = json.loads((traced / "manifest.json").read_text())
    for entry in manifest["shards"]:
        if entry["file"] == file.name:
            entry |= {"bytes": file.stat().st_size, "sha256": files(traced)[file.name]}
    (traced / "manifest.json").write_text(json.dumps(manifest))
    run = main("verify", traced, "--quiet")
    assert run.status == 1
    assert "1 missing, 0 extra" in run.out
    assert "missing    epoch 3, anchor pa1 over " in run.out


def test_append(main: Runner, traced: Path) -> None:
    """More epochs in the same directory; too few are refused."""
    run = main("append", traced, "--epochs", 11, "--quiet")
    assert run.status == 0, run.err
    assert open_dataset(traced).manifest["epochs"] == 11
    run = main("append", traced, "--epochs", 10, "--quiet")
    assert run.status == 2
    assert "expected more than the 11" in run.err


def test_export(main: Runner, traced: Path, tmp_path: Path) -> None:
    """Each layout makes its folder; unknown ones and places that are taken are refused."""
    assert main("export", traced, "--to", "mat", "--out", tmp_path / "mat").status == 0
    assert scipy.io.loadmat(tmp_path / "mat" / "passive-00002.mat")["cfr"].shape == (3, 2, 1, 819)
    assert main("export", traced, "--to", "deepmimo", "--out", tmp_path / "scenario").status == 0
    assert (tmp_path / "scenario" / "params.json").is_file()
    for arguments, words in (
        (("--to", "csv", "--out", tmp_path / "csv"), "--to: expected one of mat, deepmimo, tum, got 'csv'"),
        (("--to", "mat", "--out", tmp_path / "mat"), "expected a name that is free"),
    ):
        run = main("export", traced, *arguments)
        assert run.status == 2
        assert words in run.err


def test_impulse_responses_can_be_extracted(
    main: Runner, plan_file: Path, traced: Path, tmp_path: Path
) -> None:
    """From a dataset of impulse responses alone the delays are those of frequency responses."""
    from estimator.extract import extract_epochs

    options = ("--shard-epochs", 3, "--content", "cir", "--quiet")
    assert main("trace", plan_file, "--out", tmp_path / "cir", *options).status == 0
    taps = open_dataset(tmp_path / "cir")
    assert "cfr_re" not in next(taps.shards("passive"))
    for one, other in zip(extract_epochs(open_dataset(traced)), extract_epochs(taps), strict=True):
        for heard, again in zip(one.paths, other.paths, strict=True):
            assert heard.range_m == pytest.approx(again.range_m, abs=1e-5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--part", "half"), "--part: expected I/N, such as 2/4, got 'half'"),
        (("--part", "3/2"), "part: expected i/n with 1 <= i <= n, got 3/2"),
        (("--content", "cif"), "content: expected one of cfr, cir, both, got 'cif'"),
        (
            ("--scheduler", "tcp://127.0.0.1:9", "--jobs", "2"),
            "jobs: expected none beside a scheduler, got 2",
        ),
    ],
)
def test_bad_options(
    main: Runner, plan_file: Path, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    """One line that says what is wrong; nothing is written."""
    run = main("trace", plan_file, "--out", tmp_path / "room", "--quiet", *arguments)
    assert run.status == 2
    assert words in run.err
    assert not (tmp_path / "room").exists()


def test_an_interrupted_dataset_is_mentioned(main: Runner, plan_file: Path, traced: Path) -> None:
    """Tracing to where an interrupted dataset is says how to go on; with --resume it does."""
    whole = files(traced)
    manifest = traced / "manifest.json"
    broken = json.loads(manifest.read_text())
    broken |= {"complete": False, "shards": broken["shards"][:-1]}
    del broken["statistics"]
    manifest.write_text(json.dumps(broken))
    options = ("--shard-epochs", 3, "--licence", "CC0-1.0", "--quiet")
    run = main("trace", plan_file, "--out", traced, *options)
    assert run.status == 2
    assert "--resume goes on with it" in run.err
    assert main("trace", plan_file, "--out", traced, *options, "--resume").status == 0
    assert files(traced) == whole


def test_extract_with_tails_records_it(main: Runner, traced: Path, tmp_path: Path) -> None:
    """With --diffuse-tail delays are other ones, and the settings say with what tail."""
    found = {}
    for name, options in (("white", ()), ("tailed", ("--diffuse-tail",))):
        assert main("extract", traced, "--out", tmp_path / f"{name}.nc", "--quiet", *options).status == 0
        found[name] = load_measurements(tmp_path / f"{name}.nc")
    assert found["white"].settings["extract"]["diffuse"] is None
    assert found["tailed"].settings["extract"]["diffuse"]["tail"]["evidence"] > 0.0
    first = [each.epochs[0].paths[0].delay_s for each in found.values()]
    np.testing.assert_allclose(first[0][0], first[1][0], atol=1e-9)


def test_extract_reads_shards_one_by_one(main: Runner, traced: Path, tmp_path: Path) -> None:
    """Measurements of a dataset in shards are those of all its epochs; a lost shard is named."""
    assert main("extract", traced, "--out", tmp_path / "m.nc", "--quiet").status == 0
    shutil.move(traced / "passive-00001.nc", tmp_path / "away.nc")
    run = main("extract", traced, "--out", tmp_path / "n.nc", "--quiet")
    assert run.status == 2
    assert "passive-00001.nc: expected a shard" in run.err
