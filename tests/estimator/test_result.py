"""Results come back from their files bit by bit, and damage is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from estimator.errors import FileFormatError, OutputExistsError
from estimator.result import SlamResult, load_result, save_result

Make = Callable[..., SlamResult]


@pytest.mark.parametrize("dataset", [None, "dataset"])
def test_a_result_comes_back_bit_by_bit(tmp_path: Path, make_result: Make, dataset: str | None) -> None:
    """Every field survives, NaN of empty slots and masks included."""
    result = make_result(0.1, dataset=dataset)
    result.anchor_valid[3, 1] = False
    result.anchor_mean_m[3, 1] = np.nan
    save_result(result, tmp_path / "r.nc")
    loaded = load_result(tmp_path / "r.nc")
    for field in fields(SlamResult):
        before, after = getattr(result, field.name), getattr(loaded, field.name)
        if isinstance(before, np.ndarray):
            assert before.dtype == after.dtype, field.name
            np.testing.assert_array_equal(before, after, err_msg=field.name)
        else:
            assert before == after, field.name


def test_a_result_without_walls_comes_back(tmp_path: Path, make_result: Make) -> None:
    """A run that found no wall has empty axes."""
    full = make_result()
    result = make_result(
        wall_id=full.wall_id[:0],
        wall_valid=full.wall_valid[:, :0],
        wall_mean_m=full.wall_mean_m[:, :0],
        wall_covariance_m2=full.wall_covariance_m2[:, :0],
        wall_existence=full.wall_existence[:, :0],
    )
    save_result(result, tmp_path / "r.nc")
    assert load_result(tmp_path / "r.nc").wall_mean_m.shape == (len(full.epoch), 0, 2)


def test_equal_results_give_equal_bytes(tmp_path: Path, make_result: Make) -> None:
    """Files hold no time stamp and no path."""
    save_result(make_result(), tmp_path / "a.nc")
    save_result(make_result(), tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_every_variable_has_units(tmp_path: Path, make_result: Make) -> None:
    """Units are on every variable of the file."""
    save_result(make_result(), tmp_path / "r.nc")
    with xr.open_dataset(tmp_path / "r.nc", engine="h5netcdf") as data:
        assert all("units" in data[name].attrs for name in data.data_vars)


def test_an_existing_file_is_kept(tmp_path: Path, make_result: Make) -> None:
    """Results are never overwritten."""
    save_result(make_result(), tmp_path / "r.nc")
    before = (tmp_path / "r.nc").read_bytes()
    with pytest.raises(OutputExistsError):
        save_result(make_result(0.3), tmp_path / "r.nc")
    assert (tmp_path / "r.nc").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.drop_vars("agent_mean"), r"expected the variables \['agent_mean'\], they are missing"),
        (
            lambda d: d.assign(agent_mean=d["agent_mean"].transpose()),
            r"expected agent_mean to have axes \('epoch', 'state'\), got \('state', 'epoch'\)",
        ),
        (lambda d: d.assign_attrs(settings="{"), "expected attributes of a result"),
        (lambda d: d.assign_attrs(seed="many"), "expected attributes of a result"),
        (lambda d: d.assign_attrs(format="hapslam-measurements"), "expected format 'hapslam-result'"),
    ],
)
def test_bad_files_are_refused(
    tmp_path: Path, make_result: Make, change: Callable[[xr.Dataset], xr.Dataset], message: str
) -> None:
    """A file that lacks something, or has it otherwise, is named with what was expected."""
    save_result(make_result(), tmp_path / "r.nc")
    with xr.open_dataset(tmp_path / "r.nc", engine="h5netcdf") as data:
        changed = change(data.load())
    changed.to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    with pytest.raises(FileFormatError, match=message):
        load_result(tmp_path / "changed.nc")
