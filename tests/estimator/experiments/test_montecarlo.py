"""Runs through executors: order, equal bits, failures."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from estimator.errors import BackendError, ConfigurationError, InputError
from estimator.experiments.cases import Case
from estimator.experiments.montecarlo import SerialExecutor, map_runs, open_executor
from estimator.experiments.room import Room
from estimator.experiments.runs import Run, batches, perform, perform_together


def _fail(task: int) -> int:
    if task == 2:
        raise InputError("task 2")
    return task


def _die(task: int) -> None:
    import os

    os._exit(task)


def test_results_are_the_same_bits_with_one_job_and_with_two(walk: Callable[..., Room]) -> None:
    """Runs in other processes, in any order of completion, give what this process gives, in run order."""
    tasks = [
        Run(walk(steps), Case("hybrid", "gaussian"), seed, 10) for seed, steps in ((3, 14), (4, 6), (5, 6))
    ]
    seen: list[tuple[int, int]] = []
    with open_executor(1) as executor:
        here = map_runs(perform, tasks, executor, lambda done, total: seen.append((done, total)))
    with open_executor(2) as executor:
        there = map_runs(perform, tasks, executor)
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert [len(score.error_m) for score in there] == [14, 6, 6]
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.error_m, other.error_m)
        np.testing.assert_array_equal(one.ospa_m, other.ospa_m)


def test_runs_in_batches_are_the_runs_alone(walk: Callable[..., Room]) -> None:
    """Twenty-seven Gaussian runs make two batches, a particle run one; each scores as it does alone."""
    room = walk(6)
    tasks = [Run(room, Case("hybrid", "gaussian"), 20 + i, 10) for i in range(27)]
    tasks.append(Run(room, Case("mva", "particle"), 20, 50))
    groups = batches(tasks)
    assert [len(group) for group in groups] == [25, 2, 1]
    together = [score for scores in map_runs(perform_together, groups, SerialExecutor()) for score in scores]
    for task, score in zip(tasks, together, strict=True):
        alone = perform(task)
        np.testing.assert_allclose(score.error_m, alone.error_m, atol=1e-9)
        np.testing.assert_allclose(score.ospa_m, alone.ospa_m, atol=1e-9)
        assert score.seconds > 0.0


def test_particles_give_the_same_bits_with_equal_seeds(walk: Callable[..., Room]) -> None:
    """The particle engine's randomness comes from the run's seed alone."""
    run = Run(walk(5), Case("mva", "particle"), 7, 500)
    np.testing.assert_array_equal(perform(run).error_m, perform(run).error_m)
    other = Run(run.room, run.case, 8, 500)
    assert np.any(perform(run).error_m != perform(other).error_m)


def test_a_failing_run_fails_the_experiment_at_once() -> None:
    """A serial experiment stops at the run that fails, with its error."""
    done: list[int] = []
    with pytest.raises(InputError, match="task 2"):
        map_runs(_fail, range(10), SerialExecutor(), lambda count, _: done.append(count))
    assert done[-1] <= 3


def test_an_error_names_its_run(walk: Callable[..., Room]) -> None:
    """The error of an engine says in which run it happened: particles below 1 are refused there."""
    with pytest.raises(ConfigurationError) as caught:
        perform(Run(walk(3), Case("mva", "particle"), 11, 0))
    assert caught.value.__notes__ == ["in the run of mva/particle with seed 11"]


def test_a_killed_process_is_told() -> None:
    """A worker that dies is an error in one line, not a hang."""
    with open_executor(2) as executor, pytest.raises(BackendError, match="killed"):
        map_runs(_die, [1, 1], executor)


def test_impossible_executors_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """No jobs, jobs beside a scheduler, and a scheduler without Dask are answered with what was expected."""
    with pytest.raises(ConfigurationError, match="jobs: expected at least 1, got 0"), open_executor(0):
        pass
    with pytest.raises(ConfigurationError, match="scheduler"), open_executor(2, "tcp://127.0.0.1:1"):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigurationError, match="cluster"), open_executor(1, "tcp://127.0.0.1:1"):
        pass


def test_a_dask_cluster_gives_the_same_bits(walk: Callable[..., Room]) -> None:
    """Where Dask is installed, its workers give what this process gives."""
    distributed = pytest.importorskip("distributed")
    tasks = [Run(walk(6), Case("hybrid", "gaussian"), seed, 10) for seed in (3, 4)]
    here = map_runs(perform, tasks, SerialExecutor())
    with (
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster,
        open_executor(1, cluster.scheduler_address) as executor,
    ):
        there = map_runs(perform, tasks, executor)
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.error_m, other.error_m)
