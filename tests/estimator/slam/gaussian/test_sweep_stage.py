"""The sweep of an epoch: what it refutes is dropped, what is found elsewhere waits for the paths."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import rotation_matrix
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.slam import GaussianConfig, start
from estimator.slam.gaussian.phase import phase_of
from estimator.slam.gaussian.sweep_stage import follow_sweep
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.hypotheses import log_sum_exp

CONFIG = GaussianConfig()
NORMALS = np.deg2rad([0.0, 90.0, 180.0, 262.0])
OFFSETS = np.array([2.0, 5.0, 7.0, 3.0])


def sweep_at(place):
    """The agent's mirror images relative to it."""
    normals = np.stack([np.cos(NORMALS), np.sin(NORMALS)], axis=-1)
    images = 2.0 * (OFFSETS - normals @ np.asarray(place))[:, None] * normals
    return tuple(GaussianVrp(image, 1e-3 * np.eye(2)) for image in images)


def after(place):
    """The state after a sweep taken at a place, of an agent that stood at RP a moment ago."""
    state = start(sweep_at([0.0, 0.0]), ("a",), 28e9, CONFIG).but(epoch=1, swept_epoch=0)
    epoch = Epoch(1, 1.0, (AnchorPaths.none(),), sweep_at(place))
    phase = phase_of(1, False, CONFIG.phases, CONFIG.reduction, CONFIG.lifecycle)
    state = follow_sweep(state, epoch, stack_paths(epoch, 28e9, state.bearing_rad), CONFIG, phase)
    return state, state.hypotheses.mean[:, :2] @ rotation_matrix(state.bearing_rad).T


@pytest.mark.parametrize("place", [(0.0, 0.0), (-4.0, 2.0)])
def test_the_agent_is_where_its_sweep_fits(place):
    """Beside RP by the motion model, far from it by the whole map; four walls are enough evidence."""
    state, places = after(place)
    assert np.linalg.norm(places[state.hypotheses.best] - place) < 0.1
    assert log_sum_exp(state.hypotheses.log_weight) == pytest.approx(0.0, abs=1e-6)


def test_what_was_tracked_stays_beside_what_was_found():
    """The paths of the epoch decide: the sweep alone prunes neither."""
    _state, places = after((-4.0, 2.0))
    assert np.linalg.norm(places, axis=1).min() < 0.1
