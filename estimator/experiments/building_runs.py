"""A building mapped from its measurements, with all that was sensed and by either half alone; scored."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.evaluation.comparison import evaluate, read_truth
from estimator.evaluation.metrics import distances
from estimator.evaluation.wall_lines import line_points, seen_span
from estimator.experiments.building_limits import position_limit
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.slam.methods import METHODS
from estimator.slam.run import run_slam

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SENSING", "BuildingRun", "BuildingScore", "Sketch", "map_building"]

Array = NDArray[np.float64]

SENSING = ("hybrid", "echo_only", "passive_only")
"""What is used of a building's measurements: all, sweeps alone, paths and the sweep at the start."""
_WARM_EPOCHS = 30  # after which all that a run needs is compiled or loaded


@dataclass(frozen=True, eq=False)
class BuildingScore:
    """How a run through a building went.

    Parameters
    ----------
    error_m : ndarray, shape (T,)
        Position errors, metres.
    lost : bool
        Whether the RMSE with rotation removed is beyond use.
    flagged : ndarray of bool, shape (T,)
        Epochs that the engine itself says are doubtful or lost.
    protected : ndarray of bool, shape (T,)
        Epochs whose error is below the protection level.
    nees : float or None
        NEES per dimension, mean over epochs.
    anchors_error_m : ndarray, shape (A,)
        Errors at the end of the anchors that were heard often enough; infinite where not located. None
        where echoes alone are used.
    walls_due, walls_found, walls_false : int
        Walls that should have been found, those of them that were, and walls that are none.
    seconds : ndarray, shape (T,)
        Processor time of each step.
    """

    error_m: Array
    lost: bool
    flagged: NDArray[np.bool_]
    protected: NDArray[np.bool_]
    nees: float | None
    anchors_error_m: Array
    walls_due: int
    walls_found: int
    walls_false: int
    seconds: Array

    @property
    def silent(self) -> bool:
        """Whether the run was lost and never said so."""
        return self.lost and not self.flagged.any()

    @property
    def mae_m(self) -> float:
        """Mean position error, metres."""
        return float(self.error_m.mean())


@dataclass(frozen=True, eq=False)
class Sketch:
    """What a picture of a run shows, estimator's frame, metres.

    Parameters
    ----------
    walls_m : ndarray, shape (L, 2, 2)
        Ends of the true walls.
    track_m, estimate_m : ndarray, shape (T, 2)
        The true track and the estimated one.
    found_m : tuple of ndarray, shape (n, 2)
        Estimated walls, as far as they were seen.
    """

    walls_m: Array
    track_m: Array
    estimate_m: Array
    found_m: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class BuildingRun:
    """A building and its runs.

    Parameters
    ----------
    kind : str
        Kind of the plan.
    number : int
        Number of the plan within its kind.
    scores : mapping of str to BuildingScore or None
        By what was used (:data:`SENSING`); None where the engine refused the measurements.
    sketch : Sketch or None
        Of the run with all that was sensed.
    limit_m : ndarray, shape (T,)
        What no filter can beat on average with all that was sensed
        (:func:`estimator.experiments.building_limits.position_limit`), metres.
    """

    kind: str
    number: int
    scores: Mapping[str, BuildingScore | None]
    sketch: Sketch | None
    limit_m: Array


def map_building(
    kind: str,
    number: int,
    measurements: MeasurementSet,
    truth: xr.Dataset,
    seed: int,
    heard_epochs: int = 20,
) -> BuildingRun:
    """Map a building three times: hybrid, by echoes alone, by paths and the first sweep alone.

    Parameters
    ----------
    kind, number : str, int
        Which building, for the record.
    measurements : MeasurementSet
        All that was measured there.
    truth : xarray.Dataset
        The truth of the dataset.
    seed : int
        Seed of the engine.
    heard_epochs : int
        An anchor counts if paths of it were heard in at least this many epochs.
    """
    _warm_up(measurements.anchors, _Once(measurements))
    silent = tuple(replace(epoch, sweep=()) for epoch in measurements.epochs)
    runs = {
        "hybrid": (measurements, "hybrid"),
        "echo_only": (measurements, "active"),
        "passive_only": (replace(measurements, epochs=silent), "hybrid"),
    }
    heard = np.array([[len(paths) > 0 for paths in epoch.paths] for epoch in measurements.epochs])
    often = heard.sum(axis=0) >= heard_epochs
    scores: dict[str, BuildingScore | None] = {}
    sketch = None
    for name, (given, method) in runs.items():
        try:
            result, seconds = _timed(given, method, seed)
        except InputError:
            scores[name] = None
            continue
        scores[name] = _score(result, truth, seconds, often & METHODS[method].paths)
        if name == "hybrid":
            sketch = _sketch(result, truth)
    return BuildingRun(kind, number, scores, sketch, position_limit(measurements, truth))


class _Once:
    """Measurements that a cache takes for equal to all others: the first are enough to warm up by."""

    def __init__(self, measurements: MeasurementSet) -> None:
        self.measurements = measurements

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Once)

    def __hash__(self) -> int:
        return 0


@cache
def _warm_up(anchors: tuple[str, ...], given: _Once) -> None:
    """Compile or load what runs need, once in a process, so that no step is timed with it."""
    few = replace(given.measurements, epochs=given.measurements.epochs[:_WARM_EPOCHS])
    run_slam(few)


def _timed(measurements: MeasurementSet, method: str, seed: int) -> tuple[SlamResult, Array]:
    """A run, and the processor time of each of its steps."""
    stamps = [time.process_time()]
    result = run_slam(
        measurements, method, seed=seed, progress=lambda _done, _all: stamps.append(time.process_time())
    )
    return result, np.diff(stamps)


def _score(result: SlamResult, truth: xr.Dataset, seconds: Array, often: NDArray[np.bool_]) -> BuildingScore:
    numbers = evaluate(result, truth)
    known = read_truth(truth, result)
    error = distances(result.agent_mean[:, :2], known.track_m)
    levels = result.protection_level_m
    anchors = [np.inf if one is None else one for one in numbers["anchors_error_m"]]
    return BuildingScore(
        error_m=error,
        lost=bool(numbers["lost"]),
        flagged=np.asarray(result.flagged),
        protected=np.zeros(len(error), dtype=bool) if levels is None else np.asarray(error < levels),
        nees=numbers["nees_position_per_dim"],
        anchors_error_m=np.array(anchors)[often],
        walls_due=numbers["walls_true"],
        walls_found=numbers["walls_found"],
        walls_false=numbers["walls_false"],
        seconds=seconds,
    )


def _sketch(result: SlamResult, truth: xr.Dataset) -> Sketch:
    known = read_truth(truth, result)
    found = tuple(
        line_points(result.wall_mean_m[-1, wall], seen_span(result, wall))
        for wall in np.flatnonzero(result.wall_valid[-1]).tolist()
    )
    walls = np.concatenate([surface.segments_m for surface in known.surfaces])
    return Sketch(walls, known.track_m, result.agent_mean[:, :2], found)
