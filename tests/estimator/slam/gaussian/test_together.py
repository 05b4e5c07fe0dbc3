"""Many runs stepped together are the runs stepped alone."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.measurements import AnchorPaths
from estimator.slam import GaussianEngine, Prior, run_many, run_slam, save_state, step_many
from estimator.slam.gaussian.state import Rows
from estimator.slam.run import config_for

_EPOCHS = 30


def _varied(room, number):
    """A run: every third lacks a wall at the start, which is born later; every fourth hears anchor 2 late."""
    measured = room.measure(100 + number, _EPOCHS)
    if number % 3 == 0:
        measured = replace(measured, walls=measured.walls[:3])
    if number % 4 == 0:
        silent = AnchorPaths.none()
        late = tuple(replace(e, paths=(e.paths[0], silent)) for e in measured.epochs[:10])
        measured = replace(measured, epochs=late + measured.epochs[10:])
    return measured


def _gap(one, other):
    """Largest difference of two states' numbers, and of shapes infinity."""
    pairs = [(getattr(one.rows, e.name), getattr(other.rows, e.name)) for e in fields(Rows)]
    pairs += [(one.heard, other.heard), (one.trail, other.trail), (one.slots.wall_id, other.slots.wall_id)]
    if any(a.shape != b.shape for a, b in pairs):
        return np.inf
    return max(float(np.nanmax(np.abs(a.astype(float) - b.astype(float)), initial=0.0)) for a, b in pairs)


@pytest.fixture(scope="module")
def varied(room):
    """Twenty runs, with missed detections and clutter."""
    return [_varied(room, number) for number in range(20)]


@pytest.fixture(scope="module")
def together(varied):
    """Their engine, and their states after the last epoch, stepped together."""
    engine = GaussianEngine(config_for(varied[0]))
    return engine, _stepped(engine, varied)


def _stepped(engine, runs):
    states = [engine.start(Prior.of(run), None) for run in runs]
    for epochs in zip(*(run.epochs for run in runs), strict=True):
        states = engine.step_many(states, epochs)
    return states


def test_together_as_alone(varied, together):
    """Births, misses, clutter, late anchors: all that a run has is the same to 1e-9 in a batch and alone."""
    engine, states = together
    assert any(np.any(state.slots.born > 0) for state in states)
    assert len({state.layout.slots for state in states}) > 1
    for run, state in zip(varied, states, strict=True):
        alone = engine.start(Prior.of(run), None)
        for epoch in run.epochs:
            alone = engine.step(alone, epoch, None)
        assert _gap(state, alone) < 1e-9


def test_the_place_in_the_batch_does_not_matter(varied, together):
    """The same runs in another order give the same bits."""
    engine, _ = together
    runs = [replace(run, epochs=run.epochs[:12]) for run in varied[:5]]
    straight, turned = _stepped(engine, runs), _stepped(engine, runs[::-1])
    assert [save_state(state) for state in turned[::-1]] == [save_state(state) for state in straight]


def test_whole_runs(room):
    """Runs of unequal length and unequal models, through one call, give what one call each gives."""
    runs = [
        room.measure(7, 12),
        room.measure(8, 9),
        replace(room.measure(9, 12), settings={"measurement_model": {"range_std_m": 0.1}}),
    ]
    seen: list[tuple[int, int]] = []
    results = run_many(runs, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (33, 33)
    for run, result in zip(runs, results, strict=True):
        alone = run_slam(run)
        np.testing.assert_allclose(result.agent_mean, alone.agent_mean, atol=1e-9)
        np.testing.assert_allclose(result.wall_mean_m, alone.wall_mean_m, atol=1e-9)
        assert result.settings == alone.settings
    assert run_many([]) == []


def test_a_refused_batch_says_what_is_wrong(varied, together):
    """Neither more epochs than states nor an epoch that has been is taken; no state changes."""
    engine, states = together
    before = [save_state(state) for state in states]
    last = [run.epochs[-1] for run in varied]
    with pytest.raises(InputError, match="expected one for each of 20 states, got 19"):
        step_many(states, last[1:], engine.models)
    with pytest.raises(InputError, match="expected one later than epoch"):
        step_many(states, last, engine.models)
    assert [save_state(state) for state in states] == before


def test_a_wall_that_only_one_run_sees(room):
    """A sweep shows one run of a batch a wall that it did not have; both go on as they would alone."""
    runs = [room.measure(seed, 8, sweep_every=6) for seed in (5, 6)]
    runs = [replace(run, walls=run.walls[:3]) for run in runs]
    runs[1] = replace(runs[1], epochs=tuple(replace(epoch, sweep=()) for epoch in runs[1].epochs))
    engine = GaussianEngine(config_for(runs[0]))
    states = _stepped(engine, runs)
    assert states[0].layout.slots > states[1].layout.slots
    for run, state in zip(runs, states, strict=True):
        assert _gap(state, _stepped(engine, [run])[0]) < 1e-9
