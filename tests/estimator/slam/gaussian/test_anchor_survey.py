"""Anchors that wait for their survey while sweeps tell the track."""

from __future__ import annotations

import numpy as np

from estimator.slam.gaussian import anchor_survey
from estimator.slam.gaussian.engine import GaussianEngine
from estimator.slam.protocol import Prior, epoch_rng
from estimator.slam.run import config_for


def stepped(room, measured, epochs):
    """Engine and state after some epochs."""
    engine = GaussianEngine(config_for(measured))
    state = engine.start(Prior.of(measured), epoch_rng(0, -1))
    for epoch in measured.epochs[:epochs]:
        state = engine.step(state, epoch, epoch_rng(0, epoch.index))
    return engine, state


def in_gauge(room, state):
    """The anchors in the gauge frame."""
    c, s = np.cos(state.bearing_rad), np.sin(state.bearing_rad)
    return (room.anchors - room.track[0]) @ np.array([[c, -s], [s, c]])


def test_guesses_are_forgotten_at_the_first_sweep_on_the_way(room):
    """Then no anchor is located until its survey is sure; that one is right."""
    measured = room.measure(71, 60, sweep_every=1)
    _, early = stepped(room, measured, 2)
    assert not early.hypotheses.located.any()
    assert anchor_survey.is_tracked(early, config_for(measured).anchors)
    engine, late = stepped(room, measured, 60)
    assert late.hypotheses.located.all()
    best = late.hypotheses.best
    for k, truth in enumerate(in_gauge(room, late)):
        place = late.layout.anchor_xy(k)
        assert np.linalg.norm(late.hypotheses.mean[best, place] - truth) < 1.0
    assert engine.estimate(late).integrity.state == "ok"


def test_without_sweeps_on_the_way_anchors_start_at_once(room):
    """And nothing is surveyed."""
    measured = room.measure(72, 6)
    _, state = stepped(room, measured, 6)
    assert not anchor_survey.is_tracked(state, config_for(measured).anchors)
    assert state.hypotheses.located[state.hypotheses.best].any()


def test_an_anchor_put_elsewhere_is_moved_back(room):
    """Its survey says where it stands; all hypotheses take that place."""
    measured = room.measure(77, 70, sweep_every=1)
    engine, state = stepped(room, measured, 63)
    config = engine.models
    place = state.layout.anchor_xy(0)
    state.hypotheses.mean[:, place] += [3.0, -4.0]
    moved = state.but(epoch=64)  # its recheck is due
    after = anchor_survey.survey_anchors(moved, config, config.search)
    assert np.linalg.norm(after.hypotheses.mean[0, place] - in_gauge(room, state)[0]) < 1.5


def test_surveyed_places_are_thinned_over_the_whole_track(room):
    """However long the run, no more than the limit are kept, first and last ends included."""
    measured = room.measure(74, 150, sweep_every=1)
    engine = GaussianEngine(config_for(measured).but(survey_track=30))
    state = engine.start(Prior.of(measured), epoch_rng(0, -1))
    for epoch in measured.epochs:
        state = engine.step(state, epoch, epoch_rng(0, epoch.index))
        assert state.surveyed.epochs <= 31
    kept = state.surveyed.track.epoch
    assert kept[0] < 20
    assert kept[-1] > 120
    assert set(state.surveyed.epoch.tolist()) <= set(kept.tolist())


def test_what_was_guessed_before_the_first_sweep_told_of_no_wall(room):
    """Where sweeps come at once, walls are as they were sensed: wrong guesses would have pulled at them."""
    measured = room.measure(75, 3, sweep_every=1)
    engine = GaussianEngine(config_for(measured))
    state = engine.start(Prior.of(measured), epoch_rng(0, -1))
    walls = state.layout.walls
    sensed = state.hypotheses.covariance[0, walls, walls].copy()
    state = engine.step(state, measured.epochs[0], epoch_rng(0, 0))
    assert state.hypotheses.located.any()
    again = anchor_survey.forget_guesses(state, engine.models)
    assert not again.hypotheses.located.any()
    np.testing.assert_array_equal(again.hypotheses.covariance[0, walls, walls], sensed)
    assert again.epoch == 0
    assert again.surveyed.epochs == 1
    for epoch in measured.epochs[1:]:
        state = engine.step(state, epoch, epoch_rng(0, epoch.index))
    assert state.outset.mean.size == 0


def test_without_sweeps_the_outset_is_forgotten(room):
    """A few epochs later guesses have to be lived with."""
    measured = room.measure(76, 8)
    _, state = stepped(room, measured, 8)
    assert state.outset.mean.size == 0
