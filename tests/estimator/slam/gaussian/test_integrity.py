"""Integrity: what speaks against a run, and how far its position may be off."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch
from estimator.slam.gaussian import integrity
from estimator.slam.models.epoch_paths import stack_paths
from estimator.waveform import SPEED_OF_LIGHT_M_S

MODEL = integrity.IntegrityModel()


def after(epochs, paths, unexplained, shortfall, std, untold=0):
    """The indicators after so many epochs alike."""
    now = integrity.no_indicators(MODEL)
    for _ in range(epochs):
        now = integrity.with_epoch(now, paths, unexplained, shortfall, std, 0.0, untold, MODEL)
    return now


def test_a_run_that_explains_all_and_knows_its_place_is_ok():
    """Its protection level is that of its covariance and of what the models leave out."""
    told = integrity.judged(after(20, 10.0, 0.5, 14.0, 0.02), 0.01**2 * np.eye(2), MODEL)
    assert told.state == "ok"
    assert told.reasons == ()
    assert told.probability > 0.99
    gaussian = np.sqrt((0.01**2 + MODEL.model_std_m**2) * -2.0 * np.log(MODEL.risk))
    assert told.protection_level_m >= gaussian


def test_unexplained_paths_are_a_reason_within_few_epochs():
    """However sure the covariance is: this is the run that is wrong and does not know it."""
    now = after(40, 10.0, 0.5, 14.0, 0.02, 50)
    epochs = 0
    while integrity.judged(now, 0.01**2 * np.eye(2), MODEL).state == "ok":
        now = integrity.with_epoch(now, 10.0, 10.0, 40.0, 0.02, 0.0, 50, MODEL)
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
    """More unexplained, more short of what is possible, a wider position: each speaks against the run."""
    base = integrity.judged(after(20, 10.0, 2.0, 20.0, 0.3), 0.05 * np.eye(2), MODEL).probability
    more = integrity.judged(after(20, 10.0, 2.0 * scale, 20.0, 0.3), 0.05 * np.eye(2), MODEL).probability
    poor = integrity.judged(after(20, 10.0, 2.0, 20.0 * scale, 0.3), 0.05 * np.eye(2), MODEL).probability
    wide = integrity.judged(after(20, 10.0, 2.0, 20.0, 0.3 * scale), 0.05 * np.eye(2), MODEL).probability
    for other in (more, poor, wide):
        assert (other < base) == (scale > 1.0)


def test_a_jump_is_a_reason_for_some_epochs():
    """An agent that is farther away than it can have gone was wrong, or is: it says so, and then settles."""
    now = integrity.with_epoch(after(20, 10.0, 0.5, 14.0, 0.02), 10.0, 0.5, 14.0, 0.02, 7.0, 0, MODEL)
    told = integrity.judged(now, 0.01**2 * np.eye(2), MODEL)
    assert told.state == "lost"
    assert told.reasons == ("the position jumped by 7 m",)
    epochs = 0
    while told.state != "ok":
        now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, 0, MODEL)
        told = integrity.judged(now, 0.01**2 * np.eye(2), MODEL)
        epochs += 1
        assert epochs < 10
    assert now.jump_m == 0.0


def test_paths_that_nothing_explains_make_a_run_suspect_at_once():
    """Before it is doubtful: the next sweep is held against the whole map."""
    good = after(20, 10.0, 0.5, 14.0, 0.02)
    assert not integrity.is_suspect(good, MODEL)
    now = integrity.with_epoch(good, 10.0, 8.0, 40.0, 0.02, 0.0, 0, MODEL)
    assert not integrity.is_doubtful(now, MODEL)
    assert integrity.is_suspect(now, MODEL)
    silent = integrity.with_epoch(now, 0.0, 0.0, 0.0, 0.02, 0.0, 0, MODEL)
    assert integrity.is_suspect(silent, MODEL)


def test_paths_alone_are_trusted_less():
    """Where neither sweep nor odometry told the way for long, the same signs speak louder."""
    told, untold = (after(20, 10.0, 4.0, 20.0, 0.2, epochs) for epochs in (0, MODEL.untold_epochs + 1))
    assert untold.log_odds > told.log_odds + 1.0
    verdict = integrity.judged(untold, 0.02 * np.eye(2), MODEL)
    assert verdict.state != "ok"
    assert "neither sweep nor odometry tells the way" in verdict.reasons


def test_evidence_falls_short_by_what_is_not_known_of_paths():
    """Paths of exact prediction come out at zero on average; those of other anchors do not count."""
    rng = np.random.default_rng(0)
    std = np.array([[0.03, 0.5], [0.1, 0.1]])
    heard = (
        AnchorPaths(np.full(2, 1e-8), std[0] / SPEED_OF_LIGHT_M_S),
        AnchorPaths(np.full(2, 1e-8), std[1] / SPEED_OF_LIGHT_M_S),
    )
    paths = stack_paths(Epoch(0, 0.0, heard), 28e9)
    clutter, located = np.array([0.02, 0.4]), np.array([True, False])
    most = integrity.possible_evidence(paths, located, clutter)
    noise = std[0] * rng.normal(size=(4000, 2))
    density = np.exp(-0.5 * (noise / std[0]) ** 2) / (np.sqrt(2.0 * np.pi) * std[0] * clutter[0])
    assert most == pytest.approx(np.log(density).sum(axis=1).mean(), abs=4.0 / np.sqrt(4000))


def test_a_run_that_was_lost_stays_doubtful_until_something_but_paths_tells():
    """Walls born since explain what is heard wherever the run thinks to be; a sweep clears it."""
    untold = MODEL.untold_epochs + 1
    now = after(40, 10.0, 10.0, 60.0, 3.0, untold)
    assert integrity.judged(now, 4.5 * np.eye(2), MODEL).state == "lost"
    for _ in range(60):
        now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, untold, MODEL)
    told = integrity.judged(now, 0.01**2 * np.eye(2), MODEL)
    assert told.state == "doubtful"
    assert "it was lost, and only paths have told since" in told.reasons
    for _ in range(10):
        now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, 0, MODEL)
    assert integrity.judged(now, 0.01**2 * np.eye(2), MODEL).state == "ok"


@pytest.mark.parametrize("settled", [True, False])
def test_a_run_whose_paths_single_out_its_place_is_found_again(settled):
    """One epoch whose paths fit nowhere else ends the doubt that a loss leaves, if the map is older."""
    untold = MODEL.untold_epochs + 1
    now = after(40 if settled else 0, 10.0, 0.5, 14.0, 0.02, untold)
    for _ in range(40):
        now = integrity.with_epoch(now, 10.0, 10.0, 60.0, 3.0, 0.0, untold, MODEL)
    for _ in range(30):
        now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, untold, MODEL)
    assert integrity.is_lost(now, MODEL) == settled
    now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, untold, MODEL, regained=True)
    assert not integrity.is_lost(now, MODEL)
    for _ in range(20):
        now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, untold, MODEL)
    assert integrity.judged(now, 0.01**2 * np.eye(2), MODEL).state == ("ok" if settled else "doubtful")


def test_suspicion_is_counted_and_forgotten():
    """Epochs in a row, from nought as soon as all is well."""
    now = after(20, 10.0, 0.5, 14.0, 0.02)
    assert now.suspected == 0.0
    for count in (1.0, 2.0, 3.0):
        now = integrity.with_epoch(now, 10.0, 9.0, 40.0, 0.02, 0.0, 0, MODEL)
        assert now.suspected == count
    for _ in range(20):
        now = integrity.with_epoch(now, 10.0, 0.5, 14.0, 0.02, 0.0, 0, MODEL)
    assert now.suspected == 0.0
