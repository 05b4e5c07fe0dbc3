"""Runs of the Gaussian engine with unkind noise: each was lost, or got a wall that is none, by one rule."""

from __future__ import annotations

import numpy as np

from estimator.experiments.cases import cases_of
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
