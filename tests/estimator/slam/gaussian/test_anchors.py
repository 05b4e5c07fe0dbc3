"""The search for anchors as the engine calls it: when it is due, and where anchors start."""

from __future__ import annotations

import numpy as np

from estimator.slam import start
from estimator.slam.gaussian.anchors import initialise_anchors
from estimator.slam.gaussian.phase import phase_of
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.run import config_for


def first_epoch(room, seed):
    """A state in its first epoch, the epoch's paths and the phase."""
    measured = room.measure(seed, 1)
    config = config_for(measured)
    state = start(measured.walls, measured.anchors, measured.carrier_hz, config).but(epoch=0)
    phase = phase_of(0, False, config.phases, config.reduction, config.lifecycle)
    return state, stack_paths(measured.epochs[0], state.carrier_hz, state.bearing_rad), config, phase


def test_anchors_start_where_they_stand(room):
    """Among the hypotheses of the first epoch one has both anchors near the truth, in the gauge frame."""
    state, paths, config, phase = first_epoch(room, 4)
    after = initialise_anchors(state, paths, config, phase).hypotheses
    c, s = np.cos(state.bearing_rad), np.sin(state.bearing_rad)
    truth = (room.anchors - room.track[0]) @ np.array([[c, -s], [s, c]])
    near = np.ones(after.number, dtype=bool)
    for k in range(2):
        assert after.located[:, k].any()
        near &= np.linalg.norm(after.mean[:, state.layout.anchor_xy(k)] - truth[k], axis=1) < 2.0
    assert np.exp(after.log_weight[near]).sum() > 0.01
    assert not state.hypotheses.located.any()
    for covariance in after.covariance:
        assert np.linalg.eigvalsh(covariance).min() > -1e-8


def test_without_paths_nothing_is_located(room):
    """An epoch in which nothing was heard changes nothing."""
    state, paths, config, phase = first_epoch(room, 4)
    silent = paths._replace(number=np.zeros(2, dtype=np.int64))
    after = initialise_anchors(state, silent, config, phase)
    assert not after.hypotheses.located.any()
    assert after.hypotheses.number == 1
