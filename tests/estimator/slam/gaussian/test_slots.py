"""Slots: a new one leaves everything else where it was."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig, start
from estimator.slam.gaussian.slots import close_slot, open_slot
from estimator.slam.models.state_vector import NOWHERE_M
from estimator.slam.models.visibility import Visibility


def some_state(shared):
    """Two slots in use."""
    config = GaussianConfig()
    walls = [GaussianVrp(np.array([20.0, 1.0]), np.eye(2)), GaussianVrp(np.array([-3.0, 30.0]), np.eye(2))]
    if shared:
        return start(walls, ("a", "b"), 6e9, config)
    state = start([], ("a", "b"), 6e9, config, np.zeros((2, 2)), shared=False)
    for slot in range(2):
        state, opened = open_slot(state, Visibility())
        assert opened == slot
        state.slots.wall_id[slot] = slot
    return state


@pytest.mark.parametrize("shared", [True, False])
def test_a_new_slot_leaves_the_rest_where_it_was(shared):
    """Visibility of pairs is a square table that grows on both sides: a shift would mix walls up."""
    state = some_state(shared)
    rng = np.random.default_rng(1)
    state.hypotheses.visibility[...] = rng.random(state.hypotheses.visibility.shape)
    state.hypotheses.covariance[...] = rng.random(state.hypotheses.covariance.shape)
    grown, slot = open_slot(state, Visibility())
    assert slot == 2
    old, new, n = state.hypotheses, grown.hypotheses, state.layout.size
    assert np.array_equal(new.mean[:, :n], old.mean)
    assert np.array_equal(new.covariance[:, :n, :n], old.covariance)
    assert not new.covariance[:, n:].any()
    assert np.all(new.mean[:, n:] == NOWHERE_M)
    assert np.array_equal(new.visibility[..., :3], old.visibility[..., :3])
    if shared:
        before, after = (
            each[..., 1 + s :].reshape(1, 2, s, s) for each, s in ((old.visibility, 2), (new.visibility, 3))
        )
        assert np.array_equal(after[..., :2, :2], before)
        assert np.all(after[..., 2] == Visibility().prior_pair)
    assert not new.present[:, 2].any()
    assert grown.slots.wall_id.tolist() == [0, 1, -1]
    assert len(state.slots.wall_id) == 2


@pytest.mark.parametrize("shared", [True, False])
def test_an_empty_slot_is_used_before_a_new_one(shared):
    """States would grow for ever."""
    state = close_slot(some_state(shared), 1, Visibility())
    again, slot = open_slot(state, Visibility())
    assert slot == 1
    assert again is state
