"""A clock bias that is new in every epoch: guessed, taken out of what is remembered; else nothing is done."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.slam import GaussianConfig, start
from estimator.slam.gaussian.free_clock import guess_clock, on_present_clock, to_remember
from estimator.slam.models.epoch_paths import stack_paths
from estimator.waveform import SPEED_OF_LIGHT_M_S

NAMES = ("a", "b", "c")
PLACES = np.array([[20.0, 0.0], [-5.0, 18.0], [-12.0, -9.0]])
FREE = GaussianConfig().but(clock_free_std_m=50.0)
HELD = GaussianConfig()
BIAS_M = 30.0


def some_state(config, located=True):
    """An agent at RP that knows three anchors or none, and remembers a path of each."""
    walls = [GaussianVrp(np.array([40.0, 0.0]), 0.01 * np.eye(2))]
    state = start(walls, NAMES, 6e9, config, PLACES)
    layout, mean = state.layout, state.hypotheses.mean[0]
    for k in range(3):
        mean[layout.height2(k)] = 0.0
    state.hypotheses.covariance[0, :2, :2] = 1e-4 * np.eye(2)
    state.hypotheses.located[:] = located
    buffer = state.buffer.with_epoch(0, np.zeros(2), 0.1, heard(0.0), np.zeros((3, 1), dtype=bool), 10)
    return state.but(buffer=buffer)


def heard(bias_m):
    """The lines of sight from RP, all too long by a bias."""
    delay = (np.linalg.norm(PLACES, axis=1) + bias_m) / SPEED_OF_LIGHT_M_S
    std = np.full(1, 0.1 / SPEED_OF_LIGHT_M_S)
    return stack_paths(Epoch(0, 0.0, tuple(AnchorPaths(one[None], std) for one in delay)), 6e9)


def test_the_bias_is_guessed_where_it_is_free():
    """Some hypothesis has the true one, beside the state's own; a clock that holds gets none."""
    clutter = np.full(3, 0.02)
    free = some_state(FREE)
    bias = guess_clock(free, heard(BIAS_M), clutter, FREE).mean[:, free.layout.bias(0)]
    assert np.abs(bias - BIAS_M).min() < 1.0
    held = some_state(HELD)
    assert guess_clock(held, heard(BIAS_M), clutter, HELD) is held.hypotheses


@pytest.mark.parametrize(("config", "shift"), [(FREE, 7.0), (HELD, 0.0)])
def test_remembered_paths_follow_the_bias(config, shift):
    """They are as long as the present bias would have made them."""
    state = some_state(config)
    earlier = state.hypotheses._replace(mean=state.hypotheses.mean.copy())
    for k in range(3):
        state.hypotheses.mean[0, state.layout.bias(k)] += 7.0
    after = on_present_clock(state, earlier, config)
    np.testing.assert_allclose(after.buffer.length_m - state.buffer.length_m, shift)


@pytest.mark.parametrize(("config", "located", "kept"), [(FREE, False, 0), (FREE, True, 3), (HELD, False, 3)])
def test_an_epoch_without_a_known_bias_is_not_remembered(config, located, kept):
    """No anchor tells it: lengths of such an epoch cannot be compared with those of another."""
    assert to_remember(some_state(config, located), heard(BIAS_M), config).number.sum() == kept
