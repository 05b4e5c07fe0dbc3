"""What the SLAM engines take in: epochs of path delays and Gaussian walls.

The estimator's frame has the agent's start (the reference point, RP) as origin and
the axes of the agent's arrays at the start as axes; nothing else is known.
``hapslam extract`` writes these types to one netCDF file, ``hapslam slam`` reads it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import read_netcdf, write_netcdf
from estimator.errors import FileFormatError, InputError
from estimator.json_objects import json_object
from estimator.odometry import Odometry, odometry_of, odometry_variables
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = [
    "AnchorPaths",
    "Epoch",
    "GaussianVrp",
    "MeasurementSet",
    "Odometry",
    "load_measurements",
    "save_measurements",
]

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


def _finite(name: str, value: object, shape: tuple[int | None, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True))
    ):
        wanted = tuple("n" if want is None else want for want in shape)
        raise InputError(f"{name}: expected shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, got {array[~np.isfinite(array)][0]}")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class AnchorPaths:
    """The paths that one anchor was heard on in one epoch.

    Parameters
    ----------
    delay_s : array_like, shape (n,)
        Absolute times of flight, seconds.
    delay_std_s : array_like, shape (n,)
        Their standard deviations, seconds, positive.
    gain_db : array_like, shape (n,), optional
        Channel gain ``|a|^2`` (received power over EIRP), dB; free space gives
        minus the free-space loss. Without it (None) powers inform nothing.
    azimuth_rad, azimuth_std_rad : array_like, shape (n,), optional
        Directions of arrival in the agent's axes, radians, and their standard
        deviations; both or neither.
    """

    delay_s: Array
    delay_std_s: Array
    gain_db: Array | None = None
    azimuth_rad: Array | None = None
    azimuth_std_rad: Array | None = None

    def __post_init__(self) -> None:
        delay = _finite("delay_s", self.delay_s, (None,))
        object.__setattr__(self, "delay_std_s", _finite("delay_std_s", self.delay_std_s, delay.shape))
        for name in ("gain_db", "azimuth_rad", "azimuth_std_rad"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _finite(name, getattr(self, name), delay.shape))
        object.__setattr__(self, "delay_s", delay)
        if (delay <= 0.0).any():
            raise InputError(f"delay_s: expected positive times of flight, got {delay.min()} s")
        if (self.delay_std_s <= 0.0).any():
            raise InputError(f"delay_std_s: expected positive numbers, got {self.delay_std_s.min()} s")
        if (self.azimuth_rad is None) != (self.azimuth_std_rad is None):
            raise InputError("azimuth_rad, azimuth_std_rad: expected both or neither, got one of them")
        if self.azimuth_std_rad is not None and np.any(self.azimuth_std_rad <= 0.0):
            raise InputError(
                f"azimuth_std_rad: expected positive numbers, got {self.azimuth_std_rad.min()} rad"
            )

    @classmethod
    def none(cls) -> AnchorPaths:
        """Those of an anchor that was not heard."""
        return cls(np.empty(0), np.empty(0))

    @property
    def range_m(self) -> Array:
        """Path lengths ``c * delay_s``, shape (n,), metres."""
        return self.delay_s * SPEED_OF_LIGHT_M_S

    @property
    def range_std_m(self) -> Array:
        """Standard deviations of the path lengths, shape (n,), metres."""
        return self.delay_std_s * SPEED_OF_LIGHT_M_S

    def __len__(self) -> int:
        return int(self.delay_s.size)


@dataclass(frozen=True, eq=False)
class Epoch:
    """All anchors' paths at one instant.

    Parameters
    ----------
    index : int
        Number of the epoch, 0 for the first.
    time_s : float
        Time since the first epoch, seconds.
    paths : tuple of AnchorPaths
        One entry per anchor, always in the same order.
    sweep : tuple of GaussianVrp
        Walls that a beam sweep at this epoch saw: the agent's own mirror images relative
        to the agent, in its axes.
    heading_held : bool
        Whether the agent's axes are still those of the start. If not, directions and
        sweeps tell angles between things, but nothing of the map's rotation.
    asked : tuple of bool, optional
        Which anchors were measured to at this epoch; None says all of them. Of one that was not asked,
        that nothing was heard means nothing.
    odometry : Odometry, optional
        How the agent's body moved from the epoch before to this one; at the first epoch, which has none
        before, it says nothing. The body's x axis at the start is that of the estimator's frame.
    """

    index: int
    time_s: float
    paths: tuple[AnchorPaths, ...]
    sweep: tuple[GaussianVrp, ...] = ()
    heading_held: bool = True
    asked: tuple[bool, ...] | None = None
    odometry: Odometry | None = None

    def __post_init__(self) -> None:
        if self.asked is None:
            return
        if len(self.asked) != len(self.paths):
            raise InputError(
                f"epoch {self.index}: expected asked of {len(self.paths)} anchors, got {len(self.asked)}"
            )
        for k, (asked, paths) in enumerate(zip(self.asked, self.paths, strict=True)):
            if len(paths) and not asked:
                raise InputError(
                    f"epoch {self.index}: expected no paths of anchor {k}, which was not asked, "
                    f"got {len(paths)}"
                )

    @property
    def was_asked(self) -> NDArray[np.bool_]:
        """Whether each anchor was asked, shape (K,)."""
        return (
            np.ones(len(self.paths), dtype=bool) if self.asked is None else np.array(self.asked, dtype=bool)
        )


@dataclass(frozen=True, eq=False)
class GaussianVrp:
    """A wall as a Gaussian virtual reference point, in the estimator's frame.

    Parameters
    ----------
    mean_m : array_like, shape (2,)
        VRP relative to RP, metres.
    covariance_m2 : array_like, shape (2, 2)
        Covariance, square metres, symmetric positive definite.
    """

    mean_m: Array
    covariance_m2: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean_m", _finite("mean_m", self.mean_m, (2,)))
        covariance = _finite("covariance_m2", self.covariance_m2, (2, 2))
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise InputError(
                f"covariance_m2: expected a symmetric positive definite matrix, got {covariance.tolist()}"
            )
        object.__setattr__(self, "covariance_m2", covariance)


@dataclass(frozen=True, eq=False)
class MeasurementSet:
    """A run's measurements: the walls sensed at the start and the epochs that follow.

    Parameters
    ----------
    anchors : tuple of str
        Names of the anchors, in the order of ``Epoch.paths``.
    walls : tuple of GaussianVrp
        Walls from active sensing at the start, in any order.
    epochs : tuple of Epoch
        Ascending in index and time.
    carrier_hz : float
        Carrier frequency, hertz: gives the free-space loss of a path length.
    settings : mapping
        The configuration that produced these data (JSON types only).
    dataset : str or None
        Where the dataset lies that these measurements came from: a path relative to
        the folder of the measurement file. ``evaluate`` and ``plot`` look for the truth
        there; nothing else follows it.
    known_anchors_m : array_like, shape (K, 2), optional
        Where the anchors are, estimator's frame, metres: for the methods that know
        them. None says that nobody does.
    max_speed_m_s : float, optional
        The agent never moves faster, metres per second; None says that nothing is known.
    echo_bias_std_m : float, optional
        Of what the covariances of walls and sweeps say of range, the part that all of them have in common: a
        standard deviation, metres. None says that their errors are independent.
    """

    anchors: tuple[str, ...]
    walls: tuple[GaussianVrp, ...]
    epochs: tuple[Epoch, ...]
    carrier_hz: float
    settings: Mapping[str, Any] = field(default_factory=dict)
    dataset: str | None = None
    known_anchors_m: Array | None = None
    max_speed_m_s: float | None = None
    echo_bias_std_m: float | None = None

    def __post_init__(self) -> None:
        if self.max_speed_m_s is not None and not 0.0 < self.max_speed_m_s < np.inf:
            raise InputError(f"max_speed_m_s: expected a positive number, got {self.max_speed_m_s}")
        if self.echo_bias_std_m is not None and not 0.0 <= self.echo_bias_std_m < np.inf:
            raise InputError(f"echo_bias_std_m: expected 0 or a positive number, got {self.echo_bias_std_m}")
        if self.known_anchors_m is not None:
            places = _finite("known_anchors_m", self.known_anchors_m, (len(self.anchors), 2))
            object.__setattr__(self, "known_anchors_m", places)
        for epoch in self.epochs:
            if len(epoch.paths) != len(self.anchors):
                raise InputError(
                    f"epoch {epoch.index}: expected paths of {len(self.anchors)} anchors, "
                    f"got {len(epoch.paths)}"
                )
        for before, after in zip(self.epochs, self.epochs[1:], strict=False):
            if after.index <= before.index or after.time_s <= before.time_s:
                raise InputError(
                    f"epochs: expected ascending index and time, got {after.index} at {after.time_s} s "
                    f"after {before.index} at {before.time_s} s"
                )


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
