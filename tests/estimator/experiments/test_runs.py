"""Runs of experiments: the same bits wherever they are made, and errors that name their run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.executors import Workers, open_workers
from estimator.experiments.cases import Case
from estimator.experiments.room import Room
from estimator.experiments.runs import Run, perform


def test_results_are_the_same_bits_with_one_job_and_with_two(walk: Callable[..., Room]) -> None:
    """Runs in other processes, in any order of completion, give what this process gives, in run order."""
    tasks = [
        Run(walk(steps), Case("hybrid", "gaussian"), seed, 10) for seed, steps in ((3, 14), (4, 6), (5, 6))
    ]
    here = Workers().map(perform, tasks)
    with open_workers(2) as workers:
        there = workers.map(perform, tasks)
    assert [len(score.error_m) for score in there] == [14, 6, 6]
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.error_m, other.error_m)
        np.testing.assert_array_equal(one.ospa_m, other.ospa_m)
        assert one.seconds > 0.0


def test_particles_give_the_same_bits_with_equal_seeds(walk: Callable[..., Room]) -> None:
    """The particle engine's randomness comes from the run's seed alone."""
    run = Run(walk(5), Case("mva", "particle"), 7, 500)
    np.testing.assert_array_equal(perform(run).error_m, perform(run).error_m)
    other = Run(run.room, run.case, 8, 500)
    assert np.any(perform(run).error_m != perform(other).error_m)


def test_an_error_names_its_run(walk: Callable[..., Room]) -> None:
    """The error of an engine says in which run it happened: particles below 1 are refused there."""
    with pytest.raises(ConfigurationError) as caught:
        perform(Run(walk(3), Case("mva", "particle"), 11, 0))
    assert caught.value.__notes__ == ["in the run of mva/particle with seed 11"]
