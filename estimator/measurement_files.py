"""Measurement files (netCDF): what ``hapslam extract`` writes and ``hapslam slam`` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import read_netcdf, write_netcdf
from estimator.errors import FileFormatError, InputError
from estimator.json_objects import json_object
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from estimator.odometry import odometry_of, odometry_variables

__all__ = ["load_measurements", "save_measurements"]

FORMAT = "hapslam-measurements"
VERSION = 1
_COLUMNS = {
    "delay_s": "s",
    "delay_std_s": "s",
    "gain_db": "dB",
    "azimuth_rad": "rad",
    "azimuth_std_rad": "rad",
}
_NUMBERS = ("max_speed_m_s", "echo_bias_std_m")  # attributes that may be missing
_OPTIONAL = ("gain_db", "azimuth_rad", "azimuth_std_rad")
_DIMS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("path_valid", "delay_s", "delay_std_s", "gain_db"), ("epoch", "anchor", "path")),
    "time_s": ("epoch",),
    "vrp_mean_m": ("wall", "xy"),
    "vrp_covariance_m2": ("wall", "xy", "xy2"),
    "heading_held": ("epoch",),
    "flash_epoch": ("flash",),
    "flash_mean_m": ("flash", "xy"),
    "flash_covariance_m2": ("flash", "xy", "xy2"),
    "epoch": ("epoch",),
    "anchor": ("anchor",),
}
Array = NDArray[np.float64]


def save_measurements(measurements: MeasurementSet, path: Path) -> None:
    """Write a measurement file (netCDF); raises OutputExistsError if ``path`` exists."""
    epochs, anchors = measurements.epochs, measurements.anchors
    rank = max((len(paths) for epoch in epochs for paths in epoch.paths), default=0)
    shape = (len(epochs), len(anchors), max(rank, 1))
    valid = np.zeros(shape, dtype=np.int8)
    columns = {name: np.full(shape, np.nan) for name in _COLUMNS}
    for i, epoch in enumerate(epochs):
        for k, paths in enumerate(epoch.paths):
            valid[i, k, : len(paths)] = 1
            for name, column in columns.items():
                if getattr(paths, name) is not None:
                    column[i, k, : len(paths)] = getattr(paths, name)
    dims = ("epoch", "anchor", "path")
    columns = {name: c for name, c in columns.items() if name in _DIMS or np.isfinite(c).any()}
    walls = measurements.walls
    flashes = [(i, flash) for i, epoch in enumerate(epochs) for flash in epoch.sweep]
    known: dict[str, Any] = {}
    if measurements.known_anchors_m is not None:
        known["known_anchor_m"] = (("anchor", "xy"), measurements.known_anchors_m, {"units": "m"})
    if any(epoch.asked is not None for epoch in epochs):
        asked = np.array([epoch.was_asked for epoch in epochs], dtype=np.int8)
        known["asked"] = (
            ("epoch", "anchor"),
            asked,
            {"units": "1", "long_name": "1 where an anchor was asked"},
        )
    import xarray as xr

    data = xr.Dataset(
        {
            **known,
            **odometry_variables([epoch.odometry for epoch in epochs]),
            **{name: (dims, column, {"units": _COLUMNS[name]}) for name, column in columns.items()},
            "path_valid": (dims, valid, {"units": "1", "long_name": "1 where a path was measured"}),
            "time_s": ("epoch", np.array([epoch.time_s for epoch in epochs]), {"units": "s"}),
            "heading_held": (
                "epoch",
                np.array([epoch.heading_held for epoch in epochs], dtype=np.int8),
                {"units": "1", "long_name": "1 where the agent's axes are those of the start"},
            ),
            "flash_epoch": (
                "flash",
                np.array([i for i, _ in flashes], dtype=np.int64),
                {"units": "1", "long_name": "place in the epoch axis of each wall seen on the way"},
            ),
            "flash_mean_m": (
                ("flash", "xy"),
                np.array([flash.mean_m for _, flash in flashes]).reshape(-1, 2),
                {"units": "m", "long_name": "agent's mirror image relative to the agent, in its axes"},
            ),
            "flash_covariance_m2": (
                ("flash", "xy", "xy2"),
                np.array([flash.covariance_m2 for _, flash in flashes]).reshape(-1, 2, 2),
                {"units": "m2"},
            ),
            "vrp_mean_m": (
                ("wall", "xy"),
                np.array([wall.mean_m for wall in walls]).reshape(len(walls), 2),
                {"units": "m"},
            ),
            "vrp_covariance_m2": (
                ("wall", "xy", "xy2"),
                np.array([wall.covariance_m2 for wall in walls]).reshape(len(walls), 2, 2),
                {"units": "m2"},
            ),
        },
        coords={
            "epoch": ("epoch", np.array([epoch.index for epoch in epochs], dtype=np.int64), {"units": "1"}),
            "anchor": ("anchor", list(anchors)),
        },
        attrs={
            "format": FORMAT,
            "version": VERSION,
            "carrier_hz": measurements.carrier_hz,
            "settings": json.dumps(dict(measurements.settings), sort_keys=True),
            "dataset": measurements.dataset or "",
            **{name: value for name in _NUMBERS if (value := getattr(measurements, name)) is not None},
            "frame": "origin: agent's start (RP); axes: the agent's arrays at the start; metres",
        },
    )
    write_netcdf(data, path)


def _anchor_paths(columns: Mapping[str, Array]) -> AnchorPaths:
    """Paths as stored: an optional column that is all NaN says that nothing was measured."""
    given = {
        name: column
        for name, column in columns.items()
        if name not in _OPTIONAL or (column.size and not np.all(np.isnan(column)))
    }
    return AnchorPaths(**given)


def _asked(values: NDArray[Any], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Which anchors (T, K) were asked, as stored."""
    if values.shape != shape:
        raise InputError(f"asked: expected shape {shape}, got {values.shape}")
    return values.astype(bool)


def load_measurements(path: Path) -> MeasurementSet:
    """Read a measurement file; raises FileFormatError if it is none, InputError if its values are bad."""
    data = read_netcdf(path, FORMAT, VERSION)
    for name, dims in _DIMS.items():
        if name not in data:
            raise FileFormatError(f"{path}: expected the variable {name}, it is missing")
        if data[name].dims != dims:
            raise FileFormatError(f"{path}: expected {name} to have axes {dims}, got {data[name].dims}")
    try:
        valid = data["path_valid"].values.astype(bool)
        columns = {name: data[name].values for name in _COLUMNS if name in data}
        held = data["heading_held"].values.astype(bool)
        sweeps: dict[int, list[GaussianVrp]] = {}
        for i, mean, covariance in zip(
            data["flash_epoch"].values,
            data["flash_mean_m"].values,
            data["flash_covariance_m2"].values,
            strict=True,
        ):
            sweeps.setdefault(int(i), []).append(GaussianVrp(mean, covariance))
        index, time = data["epoch"].values, data["time_s"].values
        moved = odometry_of(data)
        walls = tuple(
            GaussianVrp(mean, covariance)
            for mean, covariance in zip(
                data["vrp_mean_m"].values, data["vrp_covariance_m2"].values, strict=True
            )
        )
        anchors = tuple(str(name) for name in data["anchor"].values)
        asked = _asked(data["asked"].values, (len(index), len(anchors))) if "asked" in data else None
        attributes = data.attrs
        epochs = tuple(
            Epoch(
                int(index[i]),
                float(time[i]),
                tuple(
                    _anchor_paths({name: c[i, k][valid[i, k]] for name, c in columns.items()})
                    for k in range(len(anchors))
                ),
                tuple(sweeps.get(i, ())),
                bool(held[i]),
                None if asked is None or asked[i].all() else tuple(asked[i].tolist()),
                moved[i],
            )
            for i in range(len(index))
        )
        return MeasurementSet(
            anchors,
            walls,
            epochs,
            float(attributes["carrier_hz"]),
            json_object(attributes["settings"], "attribute settings"),
            str(attributes["dataset"]) or None,
            data["known_anchor_m"].values if "known_anchor_m" in data else None,
            **{name: float(attributes[name]) for name in _NUMBERS if name in attributes},
        )
    except KeyError as error:
        raise FileFormatError(f"{path}: expected the attribute {error}, it is missing") from error
    except (InputError, FileFormatError) as error:
        raise type(error)(f"{path}: {error}") from error
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise FileFormatError(f"{path}: expected the values of a measurement file: {error}") from error
