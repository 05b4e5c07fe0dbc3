"""Reading some epochs of a dataset that is larger than one wants in memory."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from estimator.dataset import Dataset, DatasetWriter, open_dataset, write_shard
from estimator.errors import FileFormatError, InputError
from estimator.window import read_window


def paths(first: int, epochs: int, width: int) -> xr.Dataset:
    """Epochs with ``width`` paths, whose delays tell epoch and path."""
    epoch = np.arange(first, first + epochs)
    delay = epoch[:, None, None] + 0.01 * np.arange(width) * np.ones((epochs, 2, 1))
    return xr.Dataset(
        {
            "delay_s": (("epoch", "anchor", "path"), delay, {"units": "s"}),
            "path_valid": (("epoch", "anchor", "path"), np.ones_like(delay, dtype=np.int8)),
            "order": (("epoch", "anchor", "path"), np.ones_like(delay, dtype=np.int16)),
            "walls": (("epoch", "anchor", "path", "bounce"), np.full((*delay.shape, 2), 3, dtype=np.int16)),
        },
        coords={"epoch": epoch},
    )


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    """Twenty epochs in shards of 8, 8 and 4, with 3, 5 and 4 paths."""
    writer = DatasetWriter(tmp_path / "room", {"epochs": 20})
    for index, (first, stop, width) in enumerate([(0, 8, 3), (8, 16, 5), (16, 20, 4)]):
        name, shard = f"paths-{index:05d}.nc", paths(first, stop - first, width)
        writer.add(write_shard(writer.path, "paths", name, shard, epochs=[first, stop]))
    writer.finish()
    return open_dataset(tmp_path / "room")


@pytest.mark.parametrize(
    ("first", "stop", "width"), [(0, 20, 5), (3, 5, 3), (7, 9, 5), (15, 17, 5), (16, 20, 4)]
)
def test_a_window_is_that_part_of_the_whole(dataset: Dataset, first: int, stop: int, width: int) -> None:
    """Over borders of shards too; paths that a shard has not are masked, and no type changes."""
    window = read_window(dataset, "paths", first, stop)
    np.testing.assert_array_equal(window["epoch"], np.arange(first, stop))
    assert window.sizes["path"] == width
    valid = window["path_valid"].values.astype(bool)
    wide = {epoch: 3 if epoch < 8 else 5 if epoch < 16 else 4 for epoch in range(20)}
    np.testing.assert_array_equal(valid.sum(axis=2)[:, 0], [wide[epoch] for epoch in range(first, stop)])
    assert np.isnan(window["delay_s"].values[~valid]).all()
    expected = np.arange(first, stop)[:, None] + 0.01 * np.arange(width)
    delay = window["delay_s"].values
    np.testing.assert_allclose(delay[:, 1][valid[:, 1]], expected[valid[:, 1]])
    assert window["path_valid"].dtype == np.int8
    assert window["walls"].dtype == np.int16
    assert set(np.unique(window["walls"].values[~valid])) <= {-1}


def test_only_what_is_asked_for_is_read(dataset: Dataset) -> None:
    """Variables can be chosen, and shards outside the window may even be gone."""
    (dataset.path / "paths-00002.nc").unlink()
    window = read_window(dataset, "paths", 2, 10, ["delay_s"])
    assert list(window.data_vars) == ["delay_s"]
    with pytest.raises(FileFormatError, match="paths-00002.nc: expected a shard"):
        read_window(dataset, "paths", 2, 17)


def test_what_is_not_there_is_told(dataset: Dataset) -> None:
    """Epochs, kinds and variables that do not exist, and manifests that do not say."""
    for first, stop in ((-1, 3), (3, 3), (0, 21)):
        with pytest.raises(InputError, match="expected 0 <= first < stop <= 20"):
            read_window(dataset, "paths", first, stop)
    with pytest.raises(InputError, match="kind: expected 'passive' or 'paths'"):
        read_window(dataset, "echo", 0, 1)
    with pytest.raises(InputError, match="variables: expected some of delay_s"):
        read_window(dataset, "paths", 0, 1, ["gain"])
    manifest = json.loads((dataset.path / "manifest.json").read_text())
    del manifest["shards"][0]["epochs"]
    (dataset.path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(FileFormatError, match="expected the epochs of paths-00000.nc"):
        read_window(open_dataset(dataset.path), "paths", 0, 1)
