"""Runs of the Gaussian engine with unkind noise: each was lost, or got a wall that is none, by one rule."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.experiments.cases import cases_of, limit_of
from estimator.experiments.runs import Run, watch


def test_the_first_wall_found_is_one(walk):
    """``mva``, seed 6085: one path each of two walls looks like one wall between them for twenty epochs.

    Two detections in a row are missed, and the true wall is behind by 15 nats for a while.
    """
    result, score = watch(Run(walk(60), cases_of(["mva"], "gaussian")[0], 6085, 1))
    assert score.walls_false == 0
    assert np.all(score.error_m[10:] < 0.6)
    assert result.wall_valid[-1].any()


def test_an_anchor_that_has_to_wait_loses_nothing_by_it(walk):
    """Seed 6035, unknown clock: the right bias has to wait for the second anchor, and wrong ones have not."""
    _, score = watch(Run(walk(40), cases_of(["hybrid+clock"], "gaussian")[0], 6035, 1))
    assert not score.lost
    assert score.derotated_m[-1] < 0.6


@pytest.mark.parametrize("seed", [6013, 6043])
def test_time_differences_follow_the_walk(walk, seed):
    """A clock that is new in every epoch: few paths at the start, and every path may be of every wall."""
    _, score = watch(Run(walk(60), cases_of(["hybrid+tdoa"], "gaussian")[0], seed, 1))
    assert not score.lost
    assert score.derotated_m[-1] < 0.6


@pytest.mark.soak
def test_time_differences_lose_no_run(walk, record_property):
    """Fifty walks, and the error beside the limit of what is measured."""
    room, case = walk(), cases_of(["hybrid+tdoa"], "gaussian")[0]
    scores = [watch(Run(room, case, 6001 + i, 1))[1] for i in range(50)]
    mean = np.mean([score.error_m[-1] for score in scores])
    limit = limit_of(room, case).position_mae_m[-1]
    record_property("mean error at the end, limit, m", f"{mean:.3f}, {limit:.3f}")
    assert sum(score.lost for score in scores) == 0
    assert mean < 1.3 * limit
