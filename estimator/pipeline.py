"""From file to file: dataset -> measurements -> result -> figures of merit, picture.

Each stage reads what the one before wrote and adds one file atomically. Files name the
dataset they come from relative to their own folder, so that a folder can be moved and
equal input gives equal bytes wherever it lies. What differs from run to run (seconds,
versions, the command) goes to a sidecar, ``<result>.run.json``.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.dataset import MANIFEST, digest_of, open_dataset, write_text
from estimator.errors import FileFormatError, InputError
from estimator.json_objects import json_object
from estimator.measurement_files import load_measurements, save_measurements
from estimator.parts import PERIOD_S, Parts
from estimator.result import SlamResult, load_result, save_result

if TYPE_CHECKING:
    import xarray as xr

    from estimator.evaluation.comparison import EvaluationConfig
    from estimator.measurements import GaussianVrp, MeasurementSet

__all__ = [
    "evaluate_file",
    "evaluate_track_file",
    "extract_file",
    "find_truth",
    "plot_file",
    "run_record",
    "slam_file",
]

Progress = Callable[..., None]

_PACKAGES = ("hapslam", "numpy", "scipy", "xarray", "h5netcdf")


def extract_file(
    dataset: Path,
    out: Path,
    progress: Progress | None = None,
    resume: bool = False,
    period_s: float = PERIOD_S,
    diffuse_tail: bool = False,
) -> None:
    """Estimate delays and walls from a dataset; write a measurement file.

    Parameters
    ----------
    dataset : Path
        Dataset directory; its truth is not opened.
    out : Path
        Measurement file to write.
    progress : callable, optional
        Called with (done, total) and what else the stage has to say.
    resume : bool
        Go on with what an interrupted run left beside ``out``; begin if there is nothing.
    period_s : float
        What is done is kept as often, seconds.
    diffuse_tail : bool
        Estimate delays with the diffuse tail of each channel: for measured channels of one antenna.

    Raises
    ------
    ConfigurationError
        If there is a tail to estimate and channels are of several antennas or snapshots.
    OutputExistsError
        If ``out`` exists, or an interrupted run left parts that are not to be taken up; nothing is done then.
    FileFormatError
        If the dataset is missing, incomplete or damaged, or the parts are of other work.
    """
    from estimator.channel.diffuse import DiffuseConfig
    from estimator.extract import ExtractConfig, extract

    opened = open_dataset(dataset)
    config = ExtractConfig(diffuse=DiffuseConfig() if diffuse_tail else None)
    work = {"dataset": digest_of(opened.path / MANIFEST), "extract": asdict(config)}
    parts = Parts(out, work, resume, period_s)
    if parts.finished():
        return
    measurements = extract(opened, config, progress, parts)
    save_measurements(replace(measurements, dataset=_relative(dataset, out)), out)
    parts.remove()


def slam_file(
    measurements: Path,
    out: Path,
    method: str = "hybrid",
    engine: str = "gaussian",
    seed: int = 0,
    progress: Progress | None = None,
    command: str | None = None,
    smooth: bool = False,
    known_walls: Callable[[MeasurementSet], Sequence[GaussianVrp]] | None = None,
    resume: bool = False,
    period_s: float = PERIOD_S,
) -> None:
    """Run SLAM on a measurement file; write a result file and its sidecar.

    Parameters
    ----------
    measurements : Path
        Measurement file; the dataset it came from is not opened.
    out : Path
        Result file to write.
    method, engine, seed
        As for :func:`estimator.slam.run_slam`.
    progress : callable, optional
        Called with (done, total) and what else the stage has to say.
    command : str, optional
        The command line, for the sidecar.
    smooth : bool
        Write the whole run smoothed (:func:`estimator.slam.smoothing.refine.refine`), with its joint map.
    known_walls : callable, optional
        Walls known from a floor plan, of the measurements.
    resume, period_s
        As for :func:`extract_file`.

    Raises
    ------
    OutputExistsError
        If ``out`` exists, or an interrupted run left parts that are not to be taken up; nothing is done then.
    FileFormatError, InputError, ConfigurationError
        If the measurements cannot be read or used, the method or engine is unknown, or the parts are of
        other work.
    """
    from estimator.slam import run_slam

    loaded = load_measurements(measurements)
    begin = time.perf_counter()
    walls = None if known_walls is None else known_walls(loaded)
    work = {
        "measurements": digest_of(measurements),
        "slam": [method, engine, seed],
        "walls": None if walls is None else [[w.mean_m.tolist(), w.covariance_m2.tolist()] for w in walls],
    }
    parts = Parts(out, work, resume, period_s)
    if parts.finished():
        return
    there = max((part.done for part in parts.of("slam")), default=0)
    result = run_slam(
        loaded, method=method, engine=engine, seed=seed, progress=progress, walls=walls, parts=parts
    )
    seconds = time.perf_counter() - begin
    if smooth:
        from estimator.slam.smoothing.refine import refine

        result = refine(loaded if walls is None else replace(loaded, walls=tuple(walls)), result)
    source = None if loaded.dataset is None else _relative(measurements.parent / loaded.dataset, out)
    record = {
        "command": command,
        "seconds": {"slam": seconds},
        "seconds_per_epoch": seconds / max(len(result.epoch) - there, 1),
        "versions": {"python": platform.python_version(), **_versions()},
        "method": method,
        "engine": engine,
        "seed": seed,
        "settings": dict(result.settings),
    }
    write_text(json.dumps(record, indent=2) + "\n", _sidecar(out))  # first: who finds the result finds it too
    try:
        save_result(replace(result, dataset=source), out)
    except BaseException:
        _sidecar(out).unlink()
        raise
    parts.remove()


def evaluate_file(
    result: Path, truth: Path | None = None, config: EvaluationConfig | None = None
) -> dict[str, Any]:
    """Compare a result file with the truth; see :func:`estimator.evaluation.comparison.evaluate`.

    Parameters
    ----------
    result : Path
        Result file.
    truth : Path, optional
        Dataset with the truth; by default the one that the result names.
    config : EvaluationConfig, optional
        What counts as what.

    Raises
    ------
    FileFormatError
        If the result or the truth is missing or damaged.
    InputError
        If the truth is that of another dataset.
    """
    from estimator.evaluation.comparison import evaluate

    loaded = load_result(result)
    return evaluate(
        loaded, find_truth(result, loaded, truth), config, run_record(result).get("seconds_per_epoch")
    )


def evaluate_track_file(
    result: Path, track: Path, align: str = "start", anchors: Path | None = None, clock_offset_s: float = 0.0
) -> dict[str, Any]:
    """Compare a result file with a true track; see :func:`estimator.evaluation.track_truth.evaluate_track`.

    Parameters
    ----------
    result : Path
        Result file.
    track : Path
        The true track (:func:`estimator.readers.trajectories.read_track`), in the frame of the known anchors.
        Its times are those of the measurements, or begin at zero with the result.
    align : str
        ``start``, ``rotation`` or ``se2``.
    anchors : Path, optional
        True places of the anchors: columns ``anchor``, ``x``, ``y``.
    clock_offset_s : float
        By how much the clock of the truth is ahead, seconds.

    Raises
    ------
    FileFormatError
        If a file is missing or damaged.
    InputError
        If the times do not meet, an anchor is missing, or the alignment is unknown.
    """
    from estimator.evaluation.track_truth import evaluate_track
    from estimator.readers.csv_ranges import read_anchors
    from estimator.readers.trajectories import read_track

    loaded, true = load_result(result), read_track(track)
    stated = loaded.settings.get("measurements", {})
    start = np.array(stated.get("start_m", (0.0, 0.0)), dtype=np.float64)
    first = float(stated.get("first_time_s", 0.0))
    if true.time_s[-1] < first:  # it begins at zero
        first = 0.0
    places = None
    if anchors is not None:
        names, known = read_anchors(anchors)
        missing = [name for name in loaded.anchors if name not in names]
        if missing:
            raise InputError(f"{anchors}: expected the anchors of the result, {missing[0]!r} is missing")
        places = known[[names.index(name) for name in loaded.anchors]]
    at_epochs = true.at(loaded.time_s + first + clock_offset_s)
    return evaluate_track(loaded, at_epochs, start, align, places)


def plot_file(result: Path, out: Path, truth: Path | None = None, title: str | None = None) -> str | None:
    """Draw a result file; see :func:`estimator.evaluation.pictures.draw_map`.

    Parameters
    ----------
    result : Path
        Result file.
    out : Path
        Picture to write, PNG, SVG or PDF by its suffix.
    truth : Path, optional
        Dataset with the truth; by default the one that the result names.
    title : str, optional
        Head of the picture.

    Returns
    -------
    str or None
        Why the truth is not in the picture, if it is not: without an explicit ``truth``, a
        picture of the estimates alone is drawn where there is none.
    """
    from estimator.evaluation.pictures import (  # Matplotlib is slow to import
        draw_map,
        require_picture_name,
        save_figure,
    )

    require_picture_name(out)
    loaded = load_result(result)
    known: xr.Dataset | None = None
    missing = None
    try:
        known = find_truth(result, loaded, truth)
    except FileFormatError as error:
        if truth is not None:
            raise
        missing = str(error)
    save_figure(draw_map(loaded, known, title), out)
    return missing


def find_truth(path: Path, result: SlamResult, truth: Path | None = None) -> xr.Dataset:
    """The truth of a result: of the dataset ``truth``, or of the one that the result names.

    Raises
    ------
    FileFormatError
        If there is none; the message says where it was looked for.
    """
    if truth is not None:
        return open_dataset(truth).truth()
    if result.dataset is None:
        raise FileFormatError(f"{path}: expected the result to name its dataset, it names none; give it")
    dataset = Path(os.path.normpath(path.parent / result.dataset))
    try:
        return open_dataset(dataset).truth()
    except FileFormatError as error:
        raise FileFormatError(f"{path}: expected its dataset with the truth at {dataset}: {error}") from error


def run_record(result: Path) -> dict[str, Any]:
    """The sidecar of a result file; empty if there is none.

    Raises
    ------
    FileFormatError
        If it is not a JSON object.
    """
    file = _sidecar(result)
    if not file.is_file():
        return {}
    return json_object(file.read_bytes(), str(file))


def _sidecar(result: Path) -> Path:
    return result.with_name(result.name + ".run.json")


def _relative(dataset: Path, file: Path) -> str:
    """Path of a dataset as seen from the folder of a file, with forward slashes."""
    return Path(os.path.relpath(dataset.resolve(), file.resolve().parent)).as_posix()


def _versions() -> dict[str, str | None]:
    versions: dict[str, str | None] = {}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    return versions
