"""Odometry: what is refused, and files that come back as they were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.errors import FileFormatError, InputError
from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import Odometry
from tests.estimator.test_measurements import measured

GOOD: dict[str, Any] = {"displacement_m": [0.5, 0.01], "turn_rad": 0.1, "covariance": 1e-3 * np.eye(3)}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"displacement_m": [0.5, 0.1, 0.2]}, r"odometry displacement_m: expected shape \(2,\), got \(3,\)"),
        ({"turn_rad": np.nan}, "odometry turn_rad: expected finite numbers, got nan"),
        ({"covariance": np.eye(2)}, r"odometry covariance: expected shape \(3, 3\), got \(2, 2\)"),
        ({"covariance": np.diag([1.0, 1.0, -1e-3])}, "symmetric matrix without a negative eigenvalue"),
        (
            {"covariance": [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]},
            "odometry covariance: expected a symm",
        ),
    ],
)
def test_what_is_no_odometry_is_refused(wrong: dict[str, Any], message: str) -> None:
    """Shapes, numbers and covariances are named with what came."""
    with pytest.raises(InputError, match=message):
        Odometry(**{**GOOD, **wrong})


def test_exact_odometry_is_odometry() -> None:
    """A covariance of zeros has no negative eigenvalue."""
    assert not Odometry(**{**GOOD, "covariance": np.zeros((3, 3))}).covariance.any()


def test_files_keep_the_odometry_of_each_epoch(tmp_path: Path) -> None:
    """Epochs with odometry come back bit by bit, the others without; a set without any has no variables."""
    before = measured()
    told = Odometry(**GOOD)
    epochs = (before.epochs[0], replace(before.epochs[1], odometry=told), before.epochs[2])
    save_measurements(replace(before, epochs=epochs), tmp_path / "m.nc")
    again = load_measurements(tmp_path / "m.nc").epochs
    assert again[0].odometry is None
    assert again[2].odometry is None
    kept = again[1].odometry
    assert kept is not None
    assert kept.turn_rad == told.turn_rad
    np.testing.assert_array_equal(kept.displacement_m, told.displacement_m)
    np.testing.assert_array_equal(kept.covariance, told.covariance)
    save_measurements(before, tmp_path / "without.nc")
    with xr.open_dataset(tmp_path / "without.nc", engine="h5netcdf") as data:
        assert not any(str(name).startswith("odometry") for name in data)


def test_half_an_odometry_is_refused(tmp_path: Path) -> None:
    """A turn without a displacement is named, a number that is missing in one epoch too."""
    before = measured()
    epochs = (before.epochs[0], replace(before.epochs[1], odometry=Odometry(**GOOD)), before.epochs[2])
    save_measurements(replace(before, epochs=epochs), tmp_path / "m.nc")
    with xr.open_dataset(tmp_path / "m.nc", engine="h5netcdf") as data:
        whole = data.load()
    whole.drop_vars("odometry_displacement_m").to_netcdf(tmp_path / "half.nc", engine="h5netcdf")
    with pytest.raises(FileFormatError, match="expected odometry_displacement_m with axes"):
        load_measurements(tmp_path / "half.nc")
    whole["odometry_turn_rad"][1] = np.nan
    whole.to_netcdf(tmp_path / "gap.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="odometry turn_rad: expected finite numbers"):
        load_measurements(tmp_path / "gap.nc")
