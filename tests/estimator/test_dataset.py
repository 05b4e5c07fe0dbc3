"""The contract on disk: atomic writes, manifests, and what damage is noticed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.dataset import (
    DatasetWriter,
    open_dataset,
    read_netcdf,
    require_absent,
    write_netcdf,
    write_text,
)
from estimator.errors import FileFormatError, OutputExistsError


def shard(scale: float = 1.0) -> xr.Dataset:
    """A small shard."""
    values = scale * np.arange(600, dtype=np.float32).reshape(20, 30)
    return xr.Dataset({"cfr_re": (("epoch", "tone"), values, {"units": "1"})})


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """A complete dataset with two passive shards and a truth."""
    writer = DatasetWriter(tmp_path / "room", {"name": "room", "seed": 1})
    writer.write("passive", "passive-00000.nc", shard())
    writer.write("passive", "passive-00001.nc", shard(2.0))
    writer.write("truth", "truth.nc", shard(3.0))
    writer.finish(statistics={"found": 7})
    return tmp_path / "room"


def change_manifest(dataset: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Edit a manifest in place."""
    manifest = json.loads((dataset / "manifest.json").read_text())
    change(manifest)
    (dataset / "manifest.json").write_text(json.dumps(manifest))


def test_a_dataset_comes_back(dataset: Path) -> None:
    """Shards of a kind come back in order, with the manifest's entries."""
    opened = open_dataset(dataset)
    assert opened.manifest["name"] == "room"
    assert opened.manifest["statistics"] == {"found": 7}
    scales = [float(data["cfr_re"][0, 1]) for data in opened.shards("passive")]
    assert scales == [1.0, 2.0]
    assert opened.truth()["cfr_re"].attrs["units"] == "1"
    assert list(opened.shards("echo")) == []


def test_nothing_but_the_named_files_is_left(dataset: Path) -> None:
    """Temporary names are gone."""
    assert sorted(path.name for path in dataset.iterdir()) == [
        "manifest.json",
        "passive-00000.nc",
        "passive-00001.nc",
        "truth.nc",
    ]


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    """Files hold no time stamp and no path."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        writer = DatasetWriter(tmp_path / name / "room", {"seed": 1})
        writer.write("passive", "passive-00000.nc", shard())
        writer.finish()
    for file in ("manifest.json", "passive-00000.nc"):
        assert (tmp_path / "a/room" / file).read_bytes() == (tmp_path / "b/room" / file).read_bytes()


def test_an_existing_place_is_left_alone(dataset: Path) -> None:
    """A writer does not touch what exists, not even a dangling link."""
    before = (dataset / "manifest.json").read_bytes()
    with pytest.raises(OutputExistsError, match="expected a name that is free, but it exists"):
        DatasetWriter(dataset, {})
    assert (dataset / "manifest.json").read_bytes() == before
    (dataset.parent / "link").symlink_to(dataset.parent / "nowhere")
    with pytest.raises(OutputExistsError):
        require_absent(dataset.parent / "link")


def test_a_file_is_not_overwritten(tmp_path: Path) -> None:
    """Writing to a name that is taken raises and keeps the file."""
    write_netcdf(shard(), tmp_path / "a.nc")
    before = (tmp_path / "a.nc").read_bytes()
    with pytest.raises(OutputExistsError):
        write_netcdf(shard(5.0), tmp_path / "a.nc")
    assert (tmp_path / "a.nc").read_bytes() == before


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    """If the data cannot be written, neither the file nor a temporary one remains."""
    with pytest.raises((TypeError, ValueError)):
        write_netcdf(xr.Dataset({"bad": ("x", np.array([object()], dtype=object))}), tmp_path / "a.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_text_keeps_the_old_one(tmp_path: Path) -> None:
    """Text that cannot be encoded does not harm what was there."""
    write_text("old", tmp_path / "a.json")
    with pytest.raises(UnicodeEncodeError):
        write_text("\ud800", tmp_path / "a.json")
    assert (tmp_path / "a.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(
    "make", [lambda path: write_netcdf(shard(), path), lambda path: DatasetWriter(path, {})]
)
def test_a_missing_parent_is_named(tmp_path: Path, make: Callable[[Path], object]) -> None:
    """Folders are not made silently."""
    with pytest.raises(FileFormatError, match="expected an existing folder .*nowhere, there is none"):
        make(tmp_path / "nowhere" / "a")


def test_an_unknown_kind_is_a_mistake_of_the_caller(tmp_path: Path) -> None:
    """The kinds of shards are fixed."""
    writer = DatasetWriter(tmp_path / "room", {})
    with pytest.raises(ValueError, match="kind: expected one of .* got 'secret'"):
        writer.write("secret", "secret.nc", shard())


def test_an_interrupted_dataset_is_refused(tmp_path: Path) -> None:
    """Without finish() the manifest says so."""
    DatasetWriter(tmp_path / "room", {}).write("passive", "passive-00000.nc", shard())
    with pytest.raises(FileFormatError, match="expected a complete dataset, its generation was interrupted"):
        open_dataset(tmp_path / "room")


@pytest.mark.parametrize("keep", [0, 100, -1])
def test_a_truncated_shard_is_noticed(dataset: Path, keep: int) -> None:
    """The size is checked before anything is read."""
    file = dataset / "passive-00001.nc"
    whole = file.read_bytes()
    file.write_bytes(whole[:keep])
    shards = open_dataset(dataset).shards("passive")
    next(shards)
    with pytest.raises(
        FileFormatError, match=rf"passive-00001.nc: expected {len(whole)} bytes, got .* truncated"
    ):
        next(shards)


def test_a_changed_shard_is_noticed(dataset: Path) -> None:
    """One changed byte of the same size changes the hash."""
    file = dataset / "passive-00000.nc"
    whole = bytearray(file.read_bytes())
    whole[len(whole) // 2] ^= 1
    file.write_bytes(whole)
    with pytest.raises(
        FileFormatError, match=r"expected SHA-256 \w{12}\.\.\., got \w{12}\.\.\.; the shard was changed"
    ):
        next(open_dataset(dataset).shards("passive"))


def test_a_missing_shard_is_noticed(dataset: Path) -> None:
    """A shard that the manifest lists must be there, when it is read and not before."""
    (dataset / "truth.nc").unlink()
    opened = open_dataset(dataset)
    assert len(list(opened.shards("passive"))) == 2
    with pytest.raises(
        FileFormatError, match=r"truth.nc: expected a shard of \d+ bytes, found nothing there"
    ):
        opened.truth()


def test_a_dataset_without_truth(tmp_path: Path) -> None:
    """A dataset may come without truth, for example measured data."""
    DatasetWriter(tmp_path / "room", {}).finish()
    with pytest.raises(
        FileFormatError, match="expected a truth file in the dataset, the manifest lists none"
    ):
        open_dataset(tmp_path / "room").truth()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "manifest.json: expected JSON, could not read it"),
        ("\xff", "manifest.json: expected JSON, could not read it"),
        ("[1, 2]", "manifest.json: expected a JSON object, got list"),
        ("null", "manifest.json: expected a JSON object, got NoneType"),
        ("{}", "expected format 'hapslam-dataset' version 1, got None version None"),
        ('{"format": "hapslam-dataset", "version": 2}', "version 1, got 'hapslam-dataset' version 2"),
        ('{"format": "hapslam-dataset", "version": 1}', "expected a complete dataset"),
    ],
)
def test_a_bad_manifest_is_named(dataset: Path, text: str, message: str) -> None:
    """Not JSON, not an object, of another format or version."""
    (dataset / "manifest.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(FileFormatError, match=message):
        open_dataset(dataset)


@pytest.mark.parametrize(
    ("shards", "message"),
    [
        (None, "expected a list of shards, got NoneType"),
        (["a.nc"], "expected shards with file, kind, bytes and sha256, got 'a.nc'"),
        ([{"file": "a.nc"}], "expected shards with file, kind, bytes and sha256"),
        (
            [{"file": "../a.nc", "kind": "truth", "bytes": 1, "sha256": ""}],
            r"expected plain shard file names, got '\.\./a.nc'",
        ),
        ([{"file": 3, "kind": "truth", "bytes": 1, "sha256": ""}], "expected plain shard file names, got 3"),
    ],
)
def test_bad_shard_entries_are_named(dataset: Path, shards: object, message: str) -> None:
    """Entries that no writer makes are refused, above all those that lead out of the dataset."""
    change_manifest(dataset, lambda manifest: manifest.update(shards=shards))
    with pytest.raises(FileFormatError, match=message):
        open_dataset(dataset)


def test_a_place_that_is_no_dataset(tmp_path: Path) -> None:
    """A missing folder and a folder without manifest are the same mistake."""
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(
            FileFormatError, match="expected a dataset directory with manifest.json, found none"
        ):
            open_dataset(path)


def test_a_shard_of_another_kind_is_refused(dataset: Path) -> None:
    """A shard says what it is; the manifest must agree."""
    change_manifest(dataset, lambda manifest: manifest["shards"][2].update(kind="echo"))
    with pytest.raises(
        FileFormatError, match="expected format 'hapslam-dataset/echo' version 1, got .*truth"
    ):
        next(open_dataset(dataset).shards("echo"))


@pytest.mark.parametrize("content", [b"", b"not netCDF at all", b"\x89HDF\r\n\x1a\n" + bytes(50)])
def test_a_file_that_is_not_netcdf(tmp_path: Path, content: bytes) -> None:
    """Whatever the reader of netCDF raises becomes one clear error of one line."""
    (tmp_path / "a.nc").write_bytes(content)
    with pytest.raises(FileFormatError, match="expected a complete netCDF-4 file") as caught:
        read_netcdf(tmp_path / "a.nc", "hapslam-result", 1)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing(tmp_path: Path) -> None:
    """A missing file says so."""
    with pytest.raises(FileFormatError, match="a.nc: expected a hapslam-result file, found nothing there"):
        read_netcdf(tmp_path / "a.nc", "hapslam-result", 1)
