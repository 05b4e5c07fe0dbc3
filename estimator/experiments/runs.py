"""A SLAM run of an experiment and its errors, step by step."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.errors import HapslamError
from estimator.evaluation.comparison import EvaluationConfig
from estimator.evaluation.metrics import (
    best_rotation,
    derotated,
    distances,
    gaps,
    match,
    match_of,
    nees,
    ospa_of,
)
from estimator.experiments.cases import Case
from estimator.experiments.room import Room
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.run import config_for, run_slam

__all__ = ["Run", "Score", "perform", "score", "slam_of", "unmirrored", "watch"]

Array = NDArray[np.float64]

_JUDGE = EvaluationConfig()
_KNOWN_M2 = 1e-12  # variance of a position that is known by definition


@dataclass(frozen=True, eq=False)
class Run:
    """What to run.

    Parameters
    ----------
    room : Room
        The truth.
    case : Case
        Method, engine and options.
    seed : int
        Seed of the measurements and of the engine.
    particles : int
        Particles of the ``particle`` engine.
    """

    room: Room
    case: Case
    seed: int
    particles: int


@dataclass(frozen=True, eq=False)
class Score:
    """How a run went.

    Parameters
    ----------
    error_m, derotated_m : ndarray, shape (T,)
        Position errors, as they are and with the track's rotation about RP removed, metres.
    nees : ndarray, shape (T,)
        Normalised squared position error per dimension; NaN where the position is known.
    ospa_m : ndarray, shape (T,)
        OSPA distance (order 1, cut-off 10 m) of the VRPs from those of the walls due. Estimates of other
        walls that are there, found early or reflecting in passing only, are left out.
    rotation_rad : float
        By how much the track is turned about RP.
    walls_false : int
        Walls of the last epoch that are none.
    wall_delays : tuple of float
        For each wall that was not sensed at the start, epochs from its first reflection until
        it was found for good; infinite if it was not.
    seconds : float
        Processor time.
    """

    error_m: Array
    derotated_m: Array
    nees: Array
    ospa_m: Array
    rotation_rad: float
    walls_false: int
    wall_delays: tuple[float, ...]
    seconds: float

    @property
    def lost(self) -> bool:
        """Whether the track is beyond use: over 1 m of error (RMS), rotation removed."""
        return bool(np.sqrt(np.mean(self.derotated_m**2)) > _JUDGE.lost_m)


def slam_of(run: Run) -> SlamResult:
    """Simulate the measurements of a run and go through them."""
    case, measurements = run.case, _measured(run)
    base = ParticleConfig.of(particles=run.particles) if case.engine == "particle" else None
    config = config_for(measurements, base, case.engine)
    return run_slam(measurements, case.method, case.engine, run.seed, config)


def _measured(run: Run) -> MeasurementSet:
    return run.room.measure(run.case.simulation, run.seed, run.case.setting.anchors == "known")


def perform(run: Run) -> Score:
    """Run and judge; raises as :func:`watch`."""
    return watch(run)[1]


def watch(run: Run) -> tuple[SlamResult, Score]:
    """The estimates of a run and how it went.

    Of a method that cannot tell a map from its mirror image, the better one is judged.

    Raises
    ------
    HapslamError
        As the engine does; a note says in which run.
    """
    begin = time.process_time()
    try:
        result = slam_of(run)
    except HapslamError as error:
        error.add_note(f"in the run of {run.case.key} with seed {run.seed}")
        raise
    seconds = time.process_time() - begin
    return result, _judged(result, run, seconds)


def _judged(result: SlamResult, run: Run, seconds: float) -> Score:
    blind = run.case.setting.anchors == "ring"
    return score(unmirrored(result, run.room) if blind else result, run.room, seconds)


def unmirrored(result: SlamResult, room: Room) -> SlamResult:
    """The result or its mirror image in the x axis, whichever is nearer to the truth by a rotation.

    Path lengths alone do not tell a map from its mirror image.
    """
    flip = np.array([1.0, -1.0])
    both = np.outer(flip, flip)
    twin = replace(
        result,
        agent_mean=result.agent_mean * np.tile(flip, 2),
        agent_covariance=result.agent_covariance * np.tile(both, (2, 2)),
        anchor_mean_m=result.anchor_mean_m * flip,
        anchor_covariance_m2=result.anchor_covariance_m2 * both,
        wall_mean_m=result.wall_mean_m * flip,
        wall_covariance_m2=result.wall_covariance_m2 * both,
        candidate_agent_m=result.candidate_agent_m * flip,
        candidate_wall_mean_m=result.candidate_wall_mean_m * flip,
    )

    def misfit(candidate: SlamResult) -> float:
        track = candidate.agent_mean[:, :2]
        turned = derotated(track, float(best_rotation(track, room.track_m)))
        return float(np.sum(distances(turned, room.track_m) ** 2))

    return min(result, twin, key=misfit)


def score(result: SlamResult, room: Room, seconds: float = 0.0) -> Score:
    """Compare a result with the truth of its room."""
    track = result.agent_mean[:, :2]
    turn = float(best_rotation(track, room.track_m))
    gap = gaps(result.wall_mean_m, room.scenario.vrps_m)
    set_distance = [
        ospa_of(_required(gap[t, valid], due), _JUDGE.ospa_cutoff_m, _JUDGE.ospa_order)
        for t, (valid, due) in enumerate(zip(result.wall_valid, room.walls_due, strict=True))
    ]
    false, delays = _walls(result, room, turn)
    return Score(
        distances(track, room.track_m),
        distances(derotated(track, turn), room.track_m),
        _nees(track - room.track_m, result.agent_covariance[:, :2, :2]),
        np.array(set_distance),
        turn,
        false,
        delays,
        seconds,
    )


def _required(gap: Array, due: NDArray[np.bool_]) -> Array:
    """Distances (m, L) of estimates from walls without the rows and columns of walls that need not be found.

    The estimate of such a wall is none too many.
    """
    rows, walls = match_of(gap, _JUDGE.wall_gate_m)
    spare = rows[~due[walls]]
    return (np.delete(gap, spare, axis=0) if spare.size else gap)[:, due]


def _nees(error: Array, covariance: Array) -> Array:
    uncertain = np.linalg.eigvalsh(covariance)[:, 0] > _KNOWN_M2
    values = np.full(len(error), np.nan)
    values[uncertain] = nees(error[uncertain], covariance[uncertain])
    return values


def _walls(result: SlamResult, room: Room, turn: float) -> tuple[int, tuple[float, ...]]:
    """False walls at the end, and how long the new ones took."""
    columns = np.flatnonzero(result.wall_valid[-1])
    estimates = derotated(result.wall_mean_m[-1, columns].reshape(-1, 2), turn)
    pairs = match(estimates, room.scenario.vrps_m, _JUDGE.wall_gate_m)
    found = {wall: int(columns[i]) for i, wall in pairs}
    delays = []
    for wall in np.flatnonzero(room.walls_due[-1]).tolist():
        if wall in room.sensed:
            continue
        visible = int(np.argmax(room.reflects[:, wall]))
        confirmed = np.argmax(result.wall_valid[:, found[wall]]) if wall in found else np.inf
        delays.append(float(confirmed) - visible)
    return len(columns) - len(pairs), tuple(delays)
