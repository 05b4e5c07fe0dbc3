"""The measured sets of a folder, as runs: measurements as their readers make them, and the true track.

Sets are known by their folders' names; what a folder lacks is left out. Truth is for the comparison alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from estimator.experiments.measured.responses import response_runs
from estimator.experiments.measured.run import MeasuredRun
from estimator.experiments.measured.wheels import with_wheels
from estimator.readers.csv_ranges import read_csv
from estimator.readers.mat_ranges import read_mat, read_mat_track
from estimator.readers.range_log import RangeLog, measurements_of
from estimator.readers.sensor_lines import read_sensor_lines
from estimator.readers.text_files import lines_of, number, seconds
from estimator.readers.trajectories import Track

__all__ = ["measured_runs"]

Array = NDArray[np.float64]


def measured_runs(folder: Path) -> list[MeasuredRun]:
    """All runs of the sets in a folder.

    Raises
    ------
    FileFormatError
        If there is no known set, or a file of one is damaged.
    """
    runs: list[MeasuredRun] = []
    for name, read in _SETS.items():
        if (folder / name).is_dir():
            runs += read(folder / name)
    if not runs:
        raise FileFormatError(f"{folder}: expected folders among {', '.join(_SETS)}, found none")
    return runs


def _run(
    key: str, log: RangeLog, truth: Track, anchors_m: Array | None = None, apart: bool = False
) -> MeasuredRun:
    measurements = measurements_of(log, anchors_m)
    since = Track(truth.time_s - float(log.time_s.min()), truth.position_m)
    return MeasuredRun(key, measurements, since, apart)


def _lias(folder: Path) -> Iterator[MeasuredRun]:
    """Trolley and motion capture: the tag stands beside the rigid body's centroid."""
    tags, anchors = _places(folder / "README.md", "Tag"), _places(folder / "README.md", "Anchor")
    for run, tag in (("fast", 0), ("mid", 1)):
        ranges, capture = folder / f"ranges_{run}_tag{tag}.csv.gz", folder / f"motion_capture_{run}.csv.gz"
        if not (ranges.is_file() and capture.is_file()):
            continue
        rows = []
        for line, text in lines_of(capture, "a motion capture")[1:]:
            cells = text.split(",")
            where = f"{capture}, line {line}"
            if len(cells) < 8:
                raise FileFormatError(f"{where}: expected 8 columns, got {len(cells)}")
            rows.append([seconds(cells[0], where), *(number(cell, where) for cell in cells[1:8])])
        table = np.array(rows)
        # the body's frame is left-handed: its y and z axes point the other way
        offset = _rotated(table[:, 4:8], tags[tag] * [1.0, -1.0, -1.0])
        truth = Track(table[:, 0], table[:, 1:3] + offset[:, :2])
        yield _run(f"lias-{run}-{tag}", read_csv(ranges), truth, anchors[:, :2], apart=True)


def _rotated(quaternion: Array, point: Array) -> Array:
    """A point (3,) turned by unit quaternions (N, 4), scalar first: (N, 3)."""
    scalar, vector = quaternion[:, :1], quaternion[:, 1:]
    twice = 2.0 * np.cross(vector, point)
    return np.asarray(point + scalar * twice + np.cross(vector, twice))


def _places(path: Path, what: str) -> Array:
    """Places (n, 3) in the tables of a description, ``| Tag 0 | x | y | z |``."""
    rows = re.findall(
        rf"\|\s*{what} \d+\s*\|([^|]+)\|([^|]+)\|([^|]+)\|",
        "\n".join(t for _, t in lines_of(path, "a description")),
    )
    if not rows:
        raise FileFormatError(f"{path}: expected a table of places of {what} 0 and so on, found none")
    return np.array([[number(cell, f"{path}, {what}") for cell in row] for row in rows])


def _labyrinth(folder: Path) -> Iterator[MeasuredRun]:
    """Robot between four anchors that are asked in turn."""
    rows = []
    path = folder / "Indoor_UWB_GT.txt"
    for line, text in lines_of(path, "lines of places (point2)"):
        cells = text.split()
        if cells[0] == "point2" and len(cells) >= 4:
            rows.append([number(cell, f"{path}, line {line}") for cell in cells[1:4]])
    table = np.array(rows).reshape(-1, 3)
    sensors = folder / "Indoor_UWB_Input.txt"
    alone = _run("labyrinth", read_sensor_lines(sensors), Track(table[:, 0], table[:, 1:]))
    yield alone
    moved = with_wheels(alone.measurements, sensors)
    if moved is None:
        return
    measured, heading = moved
    yield MeasuredRun("labyrinth-odometry", measured, alone.truth, heading_rad=heading)


def _plaza(folder: Path) -> Iterator[MeasuredRun]:
    """Mower among four beacons."""
    for number_ in (1, 2):
        path = folder / f"Plaza{number_}.mat"
        if path.is_file():
            yield _run(f"plaza{number_}", read_mat(path), Track(*read_mat_track(path)))


_SETS: dict[str, Callable[[Path], Iterator[MeasuredRun]]] = {
    "lias-planar-uwb": _lias,
    "labyrinth-uwb": _labyrinth,
    "plaza-ranges": _plaza,
    "uwb-cirs-2018": response_runs,
}
