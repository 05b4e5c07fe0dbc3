"""Files sent by clients: arrays, datasets, measurement files; read in a worker process.

Nothing in a file is trusted: sizes are added up before anything is unpacked, arrays come
without pickles, names inside an archive must be those that a dataset has, and what
crashes a reader takes its worker along and no more.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from estimator.dataset import KINDS, MANIFEST, open_dataset
from estimator.errors import FileFormatError, InputError
from estimator.measurements import MeasurementSet, load_measurements
from estimator.waveform import OfdmGrid
from service.errors import TooLargeError
from service.fold import StateCache
from service.push import truth_entry

__all__ = ["FileTask", "Unpacked", "columns", "evenly_spaced", "read_arrays"]

_ZIP, _HDF5 = b"PK\x03\x04", b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Unpacked:
    """What a file held.

    Parameters
    ----------
    measurements : MeasurementSet
        Walls and epochs.
    truth : dict or None
        The truth, as ``PUT .../truth`` takes it.
    """

    measurements: MeasurementSet
    truth: dict[str, Any] | None = None


@dataclass(frozen=True)
class FileTask:
    """Read a measurement file, or a zipped dataset whose channels are estimated as `extract` does.

    Parameters
    ----------
    body : bytes
        The file.
    max_unpacked_bytes : int
        Most that it may unpack to.
    """

    body: bytes
    max_unpacked_bytes: int

    def run(self, cache: StateCache) -> Unpacked:
        """Read it; raises FileFormatError, InputError or TooLargeError."""
        del cache
        with TemporaryDirectory(prefix="hapslam-") as folder:
            if self.body.startswith(_ZIP):
                return _dataset(self.body, Path(folder), self.max_unpacked_bytes)
            if not self.body.startswith(_HDF5):
                raise FileFormatError("file: expected a netCDF-4 measurement file or a zipped dataset")
            file = Path(folder) / "measurements.nc"
            file.write_bytes(self.body)
            _check_netcdf(file, self.max_unpacked_bytes)
            try:
                return Unpacked(load_measurements(file))
            except InputError as error:
                raise FileFormatError(str(error).replace(f"{folder}/", "")) from error


def read_arrays(body: bytes, limit: int, wanted: tuple[str, ...]) -> dict[str, Any]:
    """Arrays of a netCDF or npz file by name.

    Raises
    ------
    FileFormatError
        If the file is neither, or one of them is missing.
    TooLargeError
        If it would unpack to more than ``limit`` bytes.
    """
    try:
        if body.startswith(_ZIP):
            with zipfile.ZipFile(io.BytesIO(body)) as archive:
                _check_archive(archive, limit)
            with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
                return {name: arrays[name] for name in wanted}
        if body.startswith(_HDF5):
            with TemporaryDirectory(prefix="hapslam-") as folder:
                file = Path(folder) / "channels.nc"
                file.write_bytes(body)
                _check_netcdf(file, limit)
                with xr.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
                    return {name: data[name].values for name in wanted}
    except KeyError as error:
        raise FileFormatError(f"file: expected {', '.join(wanted)}, {error} is missing") from error
    except (InputError, TooLargeError):
        raise
    except Exception as error:  # whatever the libraries make of rubbish
        raise FileFormatError(
            f"file: expected arrays without objects, could not read them: {error}"
        ) from error
    raise FileFormatError("file: expected netCDF-4 or npz, got something else")


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


def _check_archive(archive: zipfile.ZipFile, limit: int) -> None:
    size = sum(entry.file_size for entry in archive.infolist())
    if size > limit:
        raise TooLargeError(f"file: expected to unpack to at most {limit} bytes, got {size}")


def _check_netcdf(file: Path, limit: int) -> None:
    """Add up what a netCDF file's variables unpack to, before any is read."""
    try:
        with xr.open_dataset(file, engine="h5netcdf", decode_cf=False) as data:
            size = sum(8 * variable.size for variable in data.variables.values())
    except Exception as error:  # whatever the library makes of rubbish
        raise FileFormatError("file: expected a complete netCDF-4 file, could not read it") from error
    if size > limit:
        raise TooLargeError(f"file: expected to unpack to at most {limit} bytes, got {size}")


def _dataset(body: bytes, folder: Path, limit: int) -> Unpacked:
    """Unpack a dataset under names of our own and estimate its measurements."""
    from estimator.extract import extract

    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            _check_archive(archive, limit)
            members = {Path(entry.filename).name: entry for entry in archive.infolist() if not entry.is_dir()}
            for name, entry in members.items():
                if name == MANIFEST or (name.endswith(".nc") and name.split("-")[0].split(".")[0] in KINDS):
                    (folder / name).write_bytes(archive.read(entry))
    except TooLargeError:
        raise
    except Exception as error:  # whatever the libraries make of rubbish
        raise FileFormatError(f"file: expected a zipped dataset, could not unpack it: {error}") from error
    for file in folder.glob("*.nc"):
        _check_netcdf(file, limit)
    try:
        dataset = open_dataset(folder)
        measurements = extract(dataset)
        truth = None
        if any(entry["kind"] == "truth" for entry in dataset.manifest["shards"]):
            truth = truth_entry(folder)
    except InputError as error:
        raise FileFormatError(str(error).replace(f"{folder}/", "").replace(str(folder), "dataset")) from error
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"dataset: expected what `hapslam trace` writes: {error!r}") from error
    return Unpacked(measurements, truth)
