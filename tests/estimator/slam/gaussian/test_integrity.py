"""Integrity: what speaks against a run, and how far its position may be off."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.gaussian import integrity

MODEL = integrity.IntegrityModel()


def after(epochs, paths, unexplained, evidence, std):
    """The indicators after so many epochs alike."""
    now = integrity.no_indicators(MODEL)
    for _ in range(epochs):
        now = integrity.with_epoch(now, paths, unexplained, evidence, std, 0.0, MODEL)
    return now


def test_a_run_that_explains_all_and_knows_its_place_is_ok():
    """Its protection level is that of its covariance and of what the models leave out."""
    told = integrity.judged(after(20, 10.0, 0.5, 30.0, 0.02), 0.01**2 * np.eye(2), MODEL)
    assert told.state == "ok"
    assert told.reasons == ()
    assert told.probability > 0.99
    gaussian = np.sqrt((0.01**2 + MODEL.model_std_m**2) * -2.0 * np.log(MODEL.risk))
    assert told.protection_level_m >= gaussian


def test_unexplained_paths_are_a_reason_within_few_epochs():
    """However sure the covariance is: this is the run that is wrong and does not know it."""
    now = after(40, 10.0, 0.5, 30.0, 0.02)
    epochs = 0
    while integrity.judged(now, 0.01**2 * np.eye(2), MODEL).state == "ok":
        now = integrity.with_epoch(now, 10.0, 10.0, 0.0, 0.02, 0.0, MODEL)
        epochs += 1
        assert epochs < 20
    told = integrity.judged(now, 0.01**2 * np.eye(2), MODEL)
    assert any("unexplained" in reason for reason in told.reasons)
    assert told.protection_level_m > 1.0


def test_a_pose_that_nobody_knows_is_a_reason():
    """Without any path: the covariance alone says so."""
    told = integrity.judged(after(20, 0.0, 0.0, 0.0, 4.0), 8.0 * np.eye(2), MODEL)
    assert told.state == "lost"
    assert told.reasons == ("the position is known to 4 m only",)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_the_probability_falls_with_every_sign(scale):
    """More unexplained, less evidence, a wider position: each alone speaks against the run."""
    base = integrity.judged(after(20, 10.0, 2.0, 20.0, 0.3), 0.05 * np.eye(2), MODEL).probability
    more = integrity.judged(after(20, 10.0, 2.0 * scale, 20.0, 0.3), 0.05 * np.eye(2), MODEL).probability
    poor = integrity.judged(after(20, 10.0, 2.0, 20.0 / scale, 0.3), 0.05 * np.eye(2), MODEL).probability
    wide = integrity.judged(after(20, 10.0, 2.0, 20.0, 0.3 * scale), 0.05 * np.eye(2), MODEL).probability
    for other in (more, poor, wide):
        assert (other < base) == (scale > 1.0)


def test_a_jump_is_a_reason_for_some_epochs():
    """An agent that is farther away than it can have gone was wrong, or is: it says so, and then settles."""
    now = integrity.with_epoch(after(20, 10.0, 0.5, 30.0, 0.02), 10.0, 0.5, 30.0, 0.02, 7.0, MODEL)
    told = integrity.judged(now, 0.01**2 * np.eye(2), MODEL)
    assert told.state == "lost"
    assert told.reasons == ("the position jumped by 7 m",)
    epochs = 0
    while told.state != "ok":
        now = integrity.with_epoch(now, 10.0, 0.5, 30.0, 0.02, 0.0, MODEL)
        told = integrity.judged(now, 0.01**2 * np.eye(2), MODEL)
        epochs += 1
        assert epochs < 10
    assert now.jump_m == 0.0


def test_paths_that_nothing_explains_make_a_run_suspect_at_once():
    """Before it is doubtful: the next sweep is held against the whole map."""
    good = after(20, 10.0, 0.5, 30.0, 0.02)
    assert not integrity.is_suspect(good, MODEL)
    now = integrity.with_epoch(good, 10.0, 8.0, 0.0, 0.02, 0.0, MODEL)
    assert not integrity.is_doubtful(now, MODEL)
    assert integrity.is_suspect(now, MODEL)
    silent = integrity.with_epoch(now, 0.0, 0.0, 0.0, 0.02, 0.0, MODEL)
    assert integrity.is_suspect(silent, MODEL)
