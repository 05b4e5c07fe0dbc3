"""Range sets: bare path lengths of several anchors, as other people's files have them.

The layout ``ranges-npz`` is a NumPy archive of two arrays: ``range_m`` (N,), all path
lengths in metres, one epoch after the other and within an epoch one anchor after the
other; and ``offsets`` (T K + 1,), so that those of epoch ``t`` and anchor ``k`` are
``range_m[offsets[t K + k] : offsets[t K + k + 1]]``.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import FileFormatError, InputError
from estimator.measurements import AnchorPaths, Epoch, MeasurementSet
from estimator.readers.range_log import RangeLog
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["load_ranges", "read_range_set"]

_SHORTEST_M = 1e-3  # noise can make a range negative, which no path is


def load_ranges(
    path: Path,
    anchors_m: ArrayLike,
    range_std_m: float,
    start_m: ArrayLike = (0.0, 0.0),
    step_s: float = 1.0,
    carrier_hz: float = 6e9,
    model: Mapping[str, Any] | None = None,
) -> MeasurementSet:
    """Read a range set whose anchors are known.

    Parameters
    ----------
    path : Path
        The archive, layout ``ranges-npz``.
    anchors_m : array_like, shape (K, 2)
        The anchors, in any frame, metres.
    range_std_m : float
        Standard deviation of the ranges, metres.
    start_m : array_like, shape (2,)
        Where the agent starts, or is believed to start, in the same frame: RP, the origin of
        the estimator's frame.
    step_s : float
        Time between epochs, seconds.
    carrier_hz : float
        Carrier frequency, hertz; only recorded, for ranges come without powers.
    model : mapping, optional
        What else is known of the measurements: fields of
        :class:`estimator.slam.config.GaussianConfig`.

    Returns
    -------
    MeasurementSet
        With anchors named ``a1``, ``a2`` and so on; heights do not matter in the plane.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged or of another layout.
    InputError
        If places, the standard deviation or the step are not usable numbers.
    """
    places, start = np.array(anchors_m, dtype=np.float64), np.array(start_m, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2 or len(places) == 0 or start.shape != (2,):
        raise InputError(
            f"anchors_m, start_m: expected shapes (K, 2) and (2,), got {places.shape} and {start.shape}"
        )
    if not (np.all(np.isfinite(places)) and np.all(np.isfinite(start))):
        raise InputError(
            f"anchors_m, start_m: expected finite numbers, got {places.tolist()}, {start.tolist()}"
        )
    if not (np.isfinite(range_std_m) and range_std_m > 0.0 and np.isfinite(step_s) and step_s > 0.0):
        raise InputError(f"range_std_m, step_s: expected positive numbers, got {range_std_m} and {step_s}")
    ranges, offsets = _arrays(Path(path), len(places))
    delay = np.maximum(ranges, _SHORTEST_M) / SPEED_OF_LIGHT_M_S
    std = np.full(delay.shape, range_std_m / SPEED_OF_LIGHT_M_S)
    cells = [slice(a, b) for a, b in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True)]
    epochs = tuple(
        Epoch(
            t,
            t * step_s,
            tuple(
                AnchorPaths(delay[cell], std[cell]) for cell in cells[t * len(places) : (t + 1) * len(places)]
            ),
        )
        for t in range(len(cells) // len(places))
    )
    flat = {"range_std_m": range_std_m, "height2_mean_m2": 0.0, "height2_std_m2": 0.0}
    return MeasurementSet(
        anchors=tuple(f"a{k + 1}" for k in range(len(places))),
        walls=(),
        epochs=epochs,
        carrier_hz=carrier_hz,
        settings={"measurement_model": flat | dict(model or {}), "start_m": start.tolist()},
        known_anchors_m=places - start,
    )


def read_range_set(path: Path, names: Sequence[str], step_s: float = 1.0) -> RangeLog:
    """Read a range set as a log: all anchors were asked at every epoch.

    Parameters
    ----------
    path : Path
        The archive, layout ``ranges-npz``.
    names : sequence of str
        The K anchors.
    step_s : float
        Time between epochs, seconds.

    Raises
    ------
    FileFormatError
        If the file is missing, damaged or of another layout.
    InputError
        If the step is no positive number, or no anchor is named.
    """
    if not names or not 0.0 < step_s < np.inf:
        raise InputError(
            f"names, step_s: expected anchors and a positive step, got {len(names)} and {step_s}"
        )
    ranges, offsets = _arrays(Path(path), len(names))
    count = np.diff(offsets)
    cell = np.repeat(np.arange(count.size), np.maximum(count, 1))
    length = np.full(cell.size, np.nan)
    length[np.repeat(count > 0, np.maximum(count, 1))] = ranges
    epoch, anchor = np.divmod(cell, len(names))
    try:
        return RangeLog(step_s * epoch, anchor, length, tuple(names))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _arrays(path: Path, anchors: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The two arrays of an archive, checked."""
    if not path.is_file():
        raise FileFormatError(f"{path}: expected a range set (ranges-npz), found nothing there")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            ranges, offsets = archive["range_m"], archive["offsets"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FileFormatError(
            f"{path}: expected an archive with the arrays range_m and offsets, could not read it: {error}"
        ) from error
    if ranges.ndim != 1 or ranges.dtype.kind not in "fiu" or not np.all(np.isfinite(ranges)):
        raise FileFormatError(
            f"{path}: expected finite ranges in one axis, got {ranges.dtype} {ranges.shape}"
        )
    fits = offsets.ndim == 1 and offsets.dtype.kind in "iu" and offsets.size > 1
    if (
        not fits
        or offsets[0] != 0
        or np.any(np.diff(offsets.astype(np.int64)) < 0)
        or offsets[-1] != ranges.size
    ):
        raise FileFormatError(
            f"{path}: expected offsets that rise from 0 to the number of ranges, {ranges.size}"
        )
    if (offsets.size - 1) % anchors:
        raise FileFormatError(
            f"{path}: expected one cell per epoch for each of {anchors} anchors, got {offsets.size - 1} cells"
        )
    return ranges.astype(np.float64), offsets.astype(np.int64)
