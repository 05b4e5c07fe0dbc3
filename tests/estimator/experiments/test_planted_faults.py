"""The short acceptance of the joint filter: it passes, and it fails for a filter or data that are wrong.

This is the short form of the Monte Carlo of ``make soak``. The table of faults below shows what it sees:
each is planted where it could come from (in the measurements that go in, inside the engine, in the
result that comes out), and the same check that accepts the filter has to refuse it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from estimator.experiments.cases import Case, limit_of
from estimator.experiments.room import Room
from estimator.experiments.runs import score
from estimator.experiments.summary import score_curves
from estimator.measurements import AnchorPaths, Epoch, MeasurementSet
from estimator.result import SlamResult
from estimator.slam import run_slam
from estimator.slam.gaussian import engine
from estimator.specular import specular_paths

HYBRID = Case("hybrid", "gaussian")
LONG, SHORT = (10, 50), (3, 30)  # runs and steps; gross faults show in the shorter
SETTLED = 20  # steps after which errors are compared with the bound


def covariance_times_two(result: SlamResult) -> SlamResult:
    """The agent's position is claimed with twice its variance."""
    return replace(result, agent_covariance=2.0 * result.agent_covariance)


def covariance_halved(result: SlamResult) -> SlamResult:
    """The agent's position is claimed with half its variance."""
    return replace(result, agent_covariance=0.5 * result.agent_covariance)


def from_epoch(first: int, change: Callable[[Epoch, Epoch], Epoch]) -> Callable[..., MeasurementSet]:
    """Changes every epoch from ``first`` on, given the epoch and the one before."""

    def changed(measured: MeasurementSet) -> MeasurementSet:
        old = measured.epochs
        new = (change(now, before) for now, before in zip(old[first:], old[first - 1 :], strict=False))
        return replace(measured, epochs=(*old[:first], *new))

    return changed


def swapped_labels(now: Epoch, before: Epoch) -> Epoch:
    """The paths of one anchor carry the name of the other."""
    del before
    return replace(now, paths=now.paths[::-1])


def one_late(now: Epoch, before: Epoch) -> Epoch:
    """One epoch was lost, and what follows stands in its place with the next one's time."""
    return replace(now, paths=before.paths)


def first_path_missing(now: Epoch, before: Epoch) -> Epoch:
    """The shortest path of each anchor is not there."""
    del before
    return replace(now, paths=tuple(without(paths, np.argmin(paths.delay_s)) for paths in now.paths))


def without(paths: AnchorPaths, index: Any) -> AnchorPaths:
    return AnchorPaths(np.delete(paths.delay_s, index), np.delete(paths.delay_std_s, index))


def jacobians_sign(patch: pytest.MonkeyPatch) -> None:
    """Path lengths shrink where they should grow with the agent's x.

    With D that turns the sign of x, derivatives H D and a covariance P correct as H and D P D do, but for
    the sign of the shift of x: so the fault is planted round the compiled update.
    """
    right = engine.update_hypotheses

    def wrong(layout: Any, model: Any, gates: Any, limits: Any, hypotheses: Any, *rest: Any) -> Any:
        turn = np.where(np.arange(layout.size) == 0, -1.0, 1.0)
        given = hypotheses._replace(covariance=hypotheses.covariance * turn * turn[:, None])
        done = right(layout, model, gates, limits, given, *rest)
        before, after = hypotheses.mean[done.parent], done.hypotheses
        turned = after._replace(
            mean=before + turn * (after.mean - before), covariance=after.covariance * turn * turn[:, None]
        )
        return done._replace(hypotheses=turned)

    patch.setattr(engine, "update_hypotheses", wrong)


@dataclass(frozen=True)
class Fault:
    """Something wrong, the runs and steps it takes to show, and what the check has to say of it."""

    measured: Callable[[MeasurementSet], MeasurementSet] = lambda measured: measured
    engine: Callable[[pytest.MonkeyPatch], None] = lambda patch: None
    result: Callable[[SlamResult], SlamResult] = lambda result: result
    size: tuple[int, int] = SHORT
    seen: str | None = None


FAULTS = {
    "nothing": Fault(),
    "nothing, at length": Fault(size=LONG),
    "covariance times 2": Fault(result=covariance_times_two, size=LONG, seen="inconsistent"),
    "covariance halved": Fault(result=covariance_halved, size=LONG, seen="inconsistent"),
    "a Jacobian's sign": Fault(engine=jacobians_sign, seen="lost"),
    "swapped labels": Fault(measured=from_epoch(SHORT[1] // 2, swapped_labels), seen="lost"),
    "a lost epoch": Fault(measured=from_epoch(SHORT[1] // 2, one_late), seen="inaccurate"),
    "a missing path": Fault(measured=from_epoch(1, first_path_missing), seen="incomplete"),
}


def refusals(room: Room, measured: list[MeasurementSet], results: list[SlamResult]) -> list[str]:
    """Why the runs are not those of a right filter; tolerances are four Monte-Carlo standard errors."""
    scores = [score(result, room) for result in results]
    limit = limit_of(room, HYBRID)
    assert limit is not None
    error = np.array([np.mean(s.derotated_m[SETTLED:] ** 2) for s in scores])
    bound = float(np.mean(limit.derotated_rmse_m[SETTLED:] ** 2))
    nees = np.mean([np.nanmean(s.nees) for s in scores])
    found = np.concatenate([detected(room, given) for given in measured])
    expected = HYBRID.simulation.detection_probability
    refused = {
        "incomplete": found.mean() < expected - 4.0 * np.sqrt(expected * (1.0 - expected) / len(found)),
        "lost": any(s.lost for s in scores),
        "inaccurate": error.mean() > 1.2 * bound + 4.0 * error.std(ddof=1) / np.sqrt(len(scores)),
        "inconsistent": not 0.65 < nees < 1.5,
        "map": score_curves(scores)["vrp_ospa_m"][-1] > 1.2,
    }
    return [name for name, applies in refused.items() if applies]


def detected(room: Room, measured: MeasurementSet) -> np.ndarray:
    """Of each path that exists, direct or with one bounce, whether it was measured within 4.5 deviations."""
    truth = room.scenario
    paths = specular_paths(truth.start_m, truth.end_m, truth.anchors_m, truth.track_m)
    return np.array(
        [
            np.any(np.abs(heard.range_m - length) < 4.5 * heard.range_std_m)
            for t, epoch in enumerate(measured.epochs)
            for k, heard in enumerate(epoch.paths)
            for length in paths.length_m[t, k, paths.visible[t, k]]
        ]
    )


@pytest.mark.parametrize("name", FAULTS)
def test_planted_faults_are_seen(
    name: str, walk: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A filter as it is is accepted; with a fault planted in it, the same check refuses it."""
    fault = FAULTS[name]
    runs, steps = fault.size
    room = walk(steps)
    fault.engine(monkeypatch)
    measured, results = [], []
    for seed in range(100, 100 + runs):
        measured.append(fault.measured(room.measure(HYBRID.simulation, seed)))
        results.append(fault.result(run_slam(measured[-1], seed=seed)))
    seen = refusals(room, measured, results)
    assert seen == [] if fault.seen is None else fault.seen in seen, seen
