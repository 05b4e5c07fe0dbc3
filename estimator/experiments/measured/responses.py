"""Measured impulse responses: static tags, each with the anchors whose channels were logged.

The first path of each response is sought anew (:mod:`estimator.channel.leading_edge`) and put on the range
that the device logged with it: the response is aligned to the device's own first path, which that range is
of. Plain methods take the device's ranges as they are.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.channel.leading_edge import leading_edges
from estimator.errors import FileFormatError, InputError
from estimator.experiments.measured.run import MeasuredRun
from estimator.readers.range_log import RangeLog, measurements_of
from estimator.readers.trajectories import Track
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = ["response_runs"]

Array = NDArray[np.float64]
_SHAPES = {
    "cir": ("n", "taps", 2),
    "first_path_tap": ("n",),
    "range_m": ("n",),
    "link": ("n",),
    "pairs": ("links", 3),
    "anchors_m": ("anchors", 2),
    "tags_m": ("tags", 2),
}
_TAP_S = 1.0 / 998.4e6  # of the device's accumulator
_STEP_S = 0.2  # between responses: their times were not kept
_FEWEST = 3  # anchors that tell a place in the plane
_START_STD_M = 3.0  # of the anchors' centre, where the first ranges do not meet in one place


def response_runs(folder: Path) -> Iterator[MeasuredRun]:
    """A run for each tag that three anchors or more were logged with.

    Parameters
    ----------
    folder : Path
        With ``cir.npz``: responses (n, taps, 2), the device's first path, ranges, links and who they join.

    Raises
    ------
    FileFormatError
        If the file is damaged or of another layout.
    """
    data = _arrays(folder / "cir.npz")
    response = data["cir"][..., 0] + 1j * data["cir"][..., 1]
    edge = leading_edges(response, data["first_path_tap"])
    tap_m = _TAP_S * SPEED_OF_LIGHT_M_S
    length = data["range_m"] + (edge.tap - data["first_path_tap"]) * tap_m
    pair = data["pairs"][data["link"].astype(np.int64) - 1].astype(np.int64)
    for tag in np.unique(pair[:, 2]).tolist():
        own = np.flatnonzero(pair[:, 2] == tag)
        anchors = np.unique(pair[own, 1])
        if len(anchors) < _FEWEST:
            continue
        turn = np.array([np.count_nonzero(pair[own[:i], 1] == pair[own[i], 1]) for i in range(len(own))])
        column = np.searchsorted(anchors, pair[own, 1])
        places, names = data["anchors_m"][anchors - 1], tuple(f"a{k}" for k in anchors.tolist())
        logs = [
            RangeLog(_STEP_S * turn, column, lengths[own], names, anchors_m=places)
            for lengths in (length, data["range_m"])
        ]
        truth = np.tile(data["tags_m"][tag - 1], (2, 1))
        measured, plain = (_measured(log, places) for log in logs)
        yield MeasuredRun("uwb-cirs", measured, Track(np.array([0.0, 1e9]), truth), plain=plain)


def _measured(log: RangeLog, places: Array) -> Any:
    """The measurements of a tag; its start is where the first ranges meet, or somewhere among the anchors."""
    try:
        return measurements_of(log)
    except InputError:
        return measurements_of(log, start_m=places.mean(axis=0), model={"start_std_m": _START_STD_M})


def _arrays(path: Path) -> dict[str, Array]:
    """The arrays of the archive, checked; nothing is unpickled."""
    if not path.is_file():
        raise FileFormatError(f"{path}: expected impulse responses, found nothing there")
    try:
        with np.load(path, allow_pickle=False) as archive:
            data = {name: np.asarray(archive[name], dtype=np.float64) for name in _SHAPES}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FileFormatError(
            f"{path}: expected an archive with {', '.join(_SHAPES)}, could not read it: {error}"
        ) from error
    sizes: dict[str, int] = {}
    for name, wanted in _SHAPES.items():
        shape = data[name].shape
        fits = len(shape) == len(wanted) and all(
            size == (sizes.setdefault(axis, size) if isinstance(axis, str) else axis)
            for axis, size in zip(wanted, shape, strict=True)
        )
        if not fits or not np.isfinite(data[name]).all():
            raise FileFormatError(f"{path}: expected {name} as finite numbers of shape {wanted}, got {shape}")
    within = (
        (data["link"], sizes["links"]),
        (data["pairs"][:, 1], sizes["anchors"]),
        (data["pairs"][:, 2], sizes["tags"]),
    )
    for values, most in within:
        if values.size and (values.min() < 1 or values.max() > most):
            raise FileFormatError(
                f"{path}: expected numbers of 1 to {most}, got {values.min():g} to {values.max():g}"
            )
    return data
