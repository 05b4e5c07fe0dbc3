"""Logs of channel responses: NumPy archives, MATLAB and HDF5 files of impulse or frequency responses.

Arrays of a file, by their names; N responses of M samples:

``cir`` (N, M), ``tap_s``
    impulse responses, and the seconds from tap to tap; or
``cfr`` (N, M), ``tone_spacing_hz``
    frequency responses, tones in ascending order, and their spacing;
``time_s`` (N,), ``anchor`` (N,)
    when, seconds, and of which anchor, 1 to K;
``first_path_tap`` (N,), ``range_m`` (N,)
    beside ``cir``: where the device saw its first path, and the range that it made of it, metres;
``bandwidth_hz``
    beside ``cir``: the band that the pulse fills, by default all that the taps sample;
``pulse`` (P,)
    beside ``cir``: the taps of a path alone, of delay 0 from the first of them on;
``calibration`` (M,)
    beside ``cfr``: the tones of a path alone, of delay 0;
``noise_variance``, one or (N,)
    beside ``cfr``: of a tone; by default it is estimated.

The last five may be missing. A complex array may come as two real ones (``cir_re`` and ``cir_im``), or with
real and imaginary part on a last axis.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.hdf5_guard import Hdf5Limits, check_hdf5
from estimator.readers.mat_file import read_matrices

__all__ = ["ResponseLog", "read_responses"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
_COMPLEX = ("cir", "cfr", "pulse", "calibration")
_NAMES = (
    "tap_s",
    "tone_spacing_hz",
    "time_s",
    "anchor",
    "first_path_tap",
    "range_m",
    "noise_variance",
    "bandwidth_hz",
    *(f"{name}{part}" for name in _COMPLEX for part in ("", "_re", "_im")),
)
_LARGEST = 1 << 30  # bytes of all arrays


@dataclass(frozen=True, eq=False)
class ResponseLog:
    """Responses of anchors, as a file has them.

    Parameters
    ----------
    time_s : ndarray, shape (N,)
        Times, seconds.
    anchor : ndarray of int64, shape (N,)
        Which anchor, from 0.
    names : tuple of str
        The K anchors.
    response : ndarray of complex128, shape (N, M)
        Impulse responses, or frequency responses with tones in ascending order.
    tap_s : float or None
        Seconds from tap to tap of impulse responses; None for frequency responses.
    tone_spacing_hz : float or None
        Of frequency responses.
    first_path_tap, range_m : ndarray, shape (N,), or None
        Where the device saw its first path, and the range that it made of it, metres: both or none.
    noise_variance : ndarray, shape (N,), or None
        Of a tone of frequency responses.
    bandwidth_hz : float or None
        The band that impulse responses fill.
    alone : ndarray of complex128, or None
        The response of one path of delay 0: of a pulse from its first tap on, or the M tones.
    """

    time_s: Array
    anchor: NDArray[np.int64]
    names: tuple[str, ...]
    response: Complex
    tap_s: float | None = None
    tone_spacing_hz: float | None = None
    first_path_tap: Array | None = None
    range_m: Array | None = None
    noise_variance: Array | None = None
    bandwidth_hz: float | None = None
    alone: Complex | None = None


def read_responses(path: Path, names: Sequence[str] = ()) -> ResponseLog:
    """Read the responses of a file: ``.npz``, ``.mat`` (version 5 to 7.2), ``.h5`` or ``.hdf5``.

    Parameters
    ----------
    path : Path
        The file; see the head of this module.
    names : sequence of str
        The anchors in the order of their numbers; by default ``a1``, ``a2`` and so on.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged or of another layout; names the array. Nothing is unpickled.
    """
    path = Path(path)
    data = _arrays(path)
    kinds = [name for name in ("cir", "cfr") if name in data or f"{name}_re" in data]
    if len(kinds) != 1:
        raise FileFormatError(
            f"{path}: expected the array cir or cfr, got {' and '.join(kinds) or 'neither'}"
        )
    kind = kinds[0]
    response = _complex(path, data, kind, 2)
    count = len(response)
    if count == 0 or response.shape[1] < 2:
        raise FileFormatError(f"{path}: expected responses in {kind}, got shape {response.shape}")
    spacing = "tap_s" if kind == "cir" else "tone_spacing_hz"
    if spacing not in data:
        raise FileFormatError(f"{path}: expected the array {spacing} beside {kind}, it is missing")
    number = _vector(path, data, "anchor", count)
    most = len(names) or int(min(number.max(), count))
    if np.any((number != np.rint(number)) | (number < 1) | (number > most)):
        raise FileFormatError(
            f"{path}: expected anchor as numbers of 1 to {most}, got {number.min():g} to {number.max():g}"
        )
    aligned = [name for name in ("first_path_tap", "range_m") if name in data]
    if len(aligned) == 1 or (aligned and kind == "cfr"):
        raise FileFormatError(
            f"{path}: expected first_path_tap and range_m together beside cir, got {', '.join(aligned)}"
        )
    alone = _complex(path, data, name, 1) if (name := _alone(path, data, kind)) else None
    if alone is not None and (not np.any(alone) or (kind == "cfr" and len(alone) != response.shape[1])):
        raise FileFormatError(f"{path}: expected {name} that fits {kind} and is not 0, got {alone.shape}")
    noise = None
    if "noise_variance" in data:
        told = data["noise_variance"]
        data["noise_variance"] = np.repeat(told.ravel(), count) if told.size == 1 else told
        noise = _vector(path, data, "noise_variance", count)
        if kind == "cir" or not np.all(noise > 0.0):
            raise FileFormatError(f"{path}: expected noise_variance as positive numbers, beside cfr")
    return ResponseLog(
        _vector(path, data, "time_s", count),
        number.astype(np.int64) - 1,
        tuple(names) or tuple(f"a{k + 1}" for k in range(most)),
        response,
        tap_s=_scalar(path, data, "tap_s") if kind == "cir" else None,
        tone_spacing_hz=_scalar(path, data, "tone_spacing_hz") if kind == "cfr" else None,
        first_path_tap=_vector(path, data, "first_path_tap", count) if aligned else None,
        range_m=_vector(path, data, "range_m", count) if aligned else None,
        noise_variance=noise,
        bandwidth_hz=_scalar(path, data, "bandwidth_hz") if "bandwidth_hz" in data else None,
        alone=alone,
    )


def _alone(path: Path, data: dict[str, NDArray[Any]], kind: str) -> str:
    """The name of the response of one path; empty if there is none."""
    fitting, other = ("pulse", "calibration") if kind == "cir" else ("calibration", "pulse")
    if other in data or f"{other}_re" in data:
        raise FileFormatError(f"{path}: expected {fitting} beside {kind}, got {other}")
    return fitting if fitting in data or f"{fitting}_re" in data else ""


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The known arrays of a file."""
    if not path.is_file():
        raise FileFormatError(f"{path}: expected channel responses (cir or cfr), found nothing there")
    if path.suffix == ".mat":
        return dict(read_matrices(path, _NAMES))
    if path.suffix in (".h5", ".hdf5"):
        import h5py

        check_hdf5(path, Hdf5Limits(bytes=_LARGEST))
        with h5py.File(path, "r") as file:
            return {name: np.asarray(file[name]) for name in _NAMES if name in file}
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            if sum(info.file_size for info in archive.zip.infolist()) > _LARGEST:
                raise FileFormatError(f"{path}: expected arrays of at most {_LARGEST >> 20} MiB")
            return {name: archive[name] for name in _NAMES if name in archive}
    except (OSError, ValueError, KeyError, EOFError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise FileFormatError(
            f"{path}: expected an archive with the array cir or cfr, could not read it: {error}"
        ) from error


def _complex(path: Path, data: dict[str, NDArray[Any]], name: str, axes: int) -> Complex:
    """A complex array of so many axes, however its parts come."""
    if name in data:
        array = data[name]
        if array.dtype.kind in "fiu" and array.ndim == axes + 1 and array.shape[-1] == 2:
            array = array[..., 0] + 1j * array[..., 1]
        if array.dtype.kind in "fiu" or array.dtype.kind != "c":
            raise FileFormatError(
                f"{path}: expected {name} as complex numbers, got {array.dtype} {array.shape}"
            )
    else:
        real, imaginary = data[f"{name}_re"], data.get(f"{name}_im")
        if (
            imaginary is None
            or real.shape != imaginary.shape
            or {real.dtype.kind, imaginary.dtype.kind} - set("fiu")
        ):
            raise FileFormatError(f"{path}: expected {name}_re and {name}_im as real numbers of one shape")
        array = real + 1j * imaginary
        array = array.ravel() if axes == 1 else array
    if array.ndim != axes:
        raise FileFormatError(f"{path}: expected {name} of {axes} axes, got shape {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0])
        raise FileFormatError(f"{path}: expected finite numbers in {name}, got others in row {row + 1}")
    return np.asarray(array, dtype=np.complex128)


def _vector(path: Path, data: dict[str, NDArray[Any]], name: str, count: int) -> Array:
    """Finite real numbers, one of each response."""
    if name not in data:
        raise FileFormatError(f"{path}: expected the array {name}, it is missing")
    array = data[name]
    if array.dtype.kind not in "fiu" or array.size != count or max(array.shape, default=0) != count:
        raise FileFormatError(
            f"{path}: expected {count} real numbers in {name}, got {array.dtype} {array.shape}"
        )
    if not np.isfinite(array).all():
        raise FileFormatError(f"{path}: expected finite numbers in {name}, got others")
    return np.asarray(array, dtype=np.float64).ravel()


def _scalar(path: Path, data: dict[str, NDArray[Any]], name: str) -> float:
    """A positive number."""
    array = data[name]
    value = float(array.ravel()[0]) if array.size == 1 and array.dtype.kind in "fiu" else np.nan
    if not 0.0 < value < np.inf:
        raise FileFormatError(
            f"{path}: expected {name} as one positive number, got {array.dtype} {array.shape}"
        )
    return value
