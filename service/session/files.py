"""Files sent by clients: arrays, datasets, measurement files; read in a worker process.

Nothing in a file is trusted: its structure is checked and sizes are added up before anything is
unpacked, arrays come without pickles, names inside an archive must be those that a dataset has, and what
crashes a reader takes its worker along and no more.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import KINDS, MANIFEST, open_dataset
from estimator.errors import FileFormatError, InputError
from estimator.hdf5_guard import Hdf5Limits, check_hdf5
from estimator.measurement_files import load_measurements
from estimator.measurements import GaussianVrp, MeasurementSet
from estimator.waveform import OfdmGrid
from service.messages.documents import dump
from service.messages.requests import session_entry, truth_entry
from service.messages.truth import Truth
from service.session.archives import ZIP, ArchiveLimits, npz_arrays, opened_archive
from service.session.bodies import parsed
from service.session.confinement import confined_reading
from service.session.entries import EpochEntry, EpochLimits, entries_of
from service.session.tasks import TaskContext

__all__ = ["FileTask", "Unpacked", "columns", "evenly_spaced", "read_arrays"]

_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Unpacked:
    """What a file held.

    Parameters
    ----------
    session : dict
        What a request for a session says of it: anchors, carrier, and what else is known.
    walls : tuple of GaussianVrp
        Sensed at the start.
    epochs : tuple of EpochEntry
        As the log keeps them.
    truth : str or None
        The truth, as the database keeps it.
    """

    session: dict[str, Any]
    walls: tuple[GaussianVrp, ...]
    epochs: tuple[EpochEntry, ...]
    truth: str | None = None


@dataclass(frozen=True)
class FileTask:
    """Read a measurement file, or a zipped dataset whose channels are estimated as `extract` does.

    Parameters
    ----------
    body : bytes
        The file.
    max_unpacked_bytes : int
        Most that it may unpack to.
    limits : EpochLimits
        How much it may bring.
    """

    body: bytes
    max_unpacked_bytes: int
    limits: EpochLimits

    def run(self, context: TaskContext) -> Unpacked:
        """Read it; raises FileFormatError, InputError, FileTooLargeError or TooLargeError."""
        del context
        with TemporaryDirectory(prefix="hapslam-") as folder:
            if self.body.startswith(ZIP):
                return _dataset(self.body, Path(folder), self.max_unpacked_bytes, self.limits)
            if not self.body.startswith(_HDF5):
                raise FileFormatError("file: expected a netCDF-4 measurement file or a zipped dataset")
            file = Path(folder) / "measurements.nc"
            file.write_bytes(self.body)
            with confined_reading():
                check_hdf5(file, Hdf5Limits(bytes=self.max_unpacked_bytes))
                try:
                    return _unpacked(load_measurements(file), self.limits)
                except InputError as error:
                    raise _without(folder, error) from error


def read_arrays(body: bytes, limit: int, wanted: tuple[str, ...]) -> dict[str, Any]:
    """Arrays of a netCDF or npz file by name.

    Raises
    ------
    FileFormatError
        If the file is neither, or one of them is missing.
    FileTooLargeError
        If it would unpack to more than ``limit`` bytes.
    """
    if body.startswith(ZIP):
        with confined_reading(), opened_archive(body, ArchiveLimits(limit)) as archive:
            return npz_arrays(archive, wanted)
    if not body.startswith(_HDF5):
        raise FileFormatError("file: expected netCDF-4 or npz, got something else")
    with TemporaryDirectory(prefix="hapslam-") as folder:
        file = Path(folder) / "channels.nc"
        file.write_bytes(body)
        with confined_reading():
            check_hdf5(file, Hdf5Limits(bytes=limit))
            import xarray as xr  # of the readers alone: the server starts sooner

            with xr.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
                missing = [name for name in wanted if name not in data.variables]
                if missing:
                    raise FileFormatError(f"file: expected {', '.join(wanted)}, {missing[0]} is missing")
                return {name: data[name].values for name in wanted}


def columns(arrays: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """The arrays with the types that they must have; raises FileFormatError."""
    kinds = {"epoch": np.int64, "sweep_epoch": np.int64, "anchor": np.str_}
    try:
        return {name: np.asarray(value, dtype=kinds.get(name, np.float64)) for name, value in arrays.items()}
    except (ValueError, TypeError, OverflowError) as error:
        raise FileFormatError(f"file: expected arrays of numbers, and names of anchors: {error}") from error


def evenly_spaced(offset_hz: NDArray[np.float64], carrier_hz: float) -> OfdmGrid:
    """The grid of the tones: what matters to delays is their number and their spacing.

    Raises
    ------
    FileFormatError
        If they are not ascending and evenly spaced.
    """
    spacing = np.diff(offset_hz) if offset_hz.ndim == 1 else np.zeros(0)
    even = spacing.size and np.all(np.isfinite(spacing)) and spacing[0] > 0.0
    if not even or not np.allclose(spacing, spacing[0], rtol=1e-6):
        raise FileFormatError(
            "tone_offset_hz: expected ascending, evenly spaced offsets of two tones or more"
        )
    return OfdmGrid(carrier_hz, float(spacing.mean()), len(offset_hz))


def _unpacked(
    measurements: MeasurementSet, limits: EpochLimits, truth: dict[str, Any] | None = None
) -> Unpacked:
    limits.check_count(len(measurements.epochs))
    entry = session_entry(measurements)
    if truth is None:
        return Unpacked(entry, measurements.walls, entries_of(measurements.epochs, limits))
    text = parsed(Truth, dump(truth).encode()).model_dump_json()
    entry["start_frame"] = truth["start_frame"]
    return Unpacked(entry, measurements.walls, entries_of(measurements.epochs, limits), text)


def _dataset(body: bytes, folder: Path, limit: int, limits: EpochLimits) -> Unpacked:
    """Unpack a dataset under names of our own and estimate its measurements."""
    from estimator.extract import extract

    with confined_reading(), opened_archive(body, ArchiveLimits(limit)) as archive:
        members = {Path(entry.filename).name: entry for entry in archive.infolist() if not entry.is_dir()}
        for name, entry in members.items():
            if name == MANIFEST or (name.endswith(".nc") and name.split("-")[0].split(".")[0] in KINDS):
                (folder / name).write_bytes(archive.read(entry))
    shards = sorted(folder.glob("*.nc"))
    with confined_reading():
        left = limit
        for file in shards:
            left -= check_hdf5(file, Hdf5Limits(bytes=left))
        try:
            dataset = open_dataset(folder)
            measurements = extract(dataset)
            if not any(entry["kind"] == "truth" for entry in dataset.manifest["shards"]):
                return _unpacked(measurements, limits)
            return _unpacked(measurements, limits, truth_entry(folder))
        except InputError as error:
            raise _without(str(folder), error) from error


def _without(folder: str, error: InputError) -> FileFormatError:
    """An error without the name of the folder in which the file lay, and without what a library said."""
    text = (
        str(error).partition(", could not read it:")[0].replace(f"{folder}/", "").replace(folder, "dataset")
    )
    return type(error)(text) if isinstance(error, FileFormatError) else FileFormatError(text)
