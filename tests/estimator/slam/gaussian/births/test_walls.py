"""A wall enters the hypotheses: as a bank beside all hypotheses without it, with the right correlations."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam import Prior, start
from estimator.slam.gaussian.births.walls import bear_wall
from estimator.slam.gaussian.engine import GaussianEngine
from estimator.slam.run import config_for


@pytest.fixture(scope="module")
def birth(room):
    """The state just before the first birth of a run, its configuration, and the state after."""
    measured = room.measure(3, 120)
    config = config_for(measured)
    engine = GaussianEngine(config)
    state = engine.start(Prior.of(measured), None)
    for epoch in measured.epochs:
        before, state = state, engine.step(state, epoch, None)
        if state.next_wall_id > before.next_wall_id:
            return state, config
    raise AssertionError("expected a birth")


def test_a_birth_takes_its_paths(birth):
    """The same paths must not start a second wall; and while one is tentative, no other starts."""
    state, config = birth
    assert state.slots.tentative.size == 1
    assert bear_wall(state, config, 12.0) is state
    slot = int(state.slots.tentative[0])
    assert state.slots.born[slot] == state.epoch
    freed = state.slots.copy()
    freed.confirmed[slot] = True
    again = bear_wall(state.but(slots=freed), config, 12.0)
    assert again.next_wall_id == state.next_wall_id


def test_new_walls_are_correlated_with_what_they_came_from(birth):
    """A Gaussian stays one: no variance is negative, and the wall's errors are the anchor's too."""
    state, _ = birth
    slot = int(state.slots.tentative[0])
    new = state.hypotheses.present[:, slot]
    assert new.any()
    columns = state.layout.wall(slot)
    for covariance in state.hypotheses.covariance[new]:
        assert np.linalg.eigvalsh(covariance).min() > -1e-9
        assert np.abs(covariance[columns, : columns.start]).max() > 1e-6
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-9)
    assert np.exp(state.hypotheses.log_weight).sum() == pytest.approx(1.0)


def test_without_unassociated_paths_nothing_is_born(room):
    """A state before the first epoch asks for nothing."""
    measured = room.measure(3, 1)
    config = config_for(measured)
    state = start(measured.walls, measured.anchors, measured.carrier_hz, config)
    assert bear_wall(state, config, 12.0) is state
