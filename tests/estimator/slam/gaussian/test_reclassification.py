"""Which paths the map explains, now and then, and the legs that they show to be free."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam import GaussianEngine, Prior
from estimator.slam.gaussian.reclassification import Reclassification, associated_now, associated_then
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.run import config_for
from tests.estimator.slam.gaussian.test_update import path_table
from tests.estimator.slam.models.test_path_lengths import state_of

MODEL = Reclassification()


@pytest.fixture(scope="module")
def settled(room):
    """A state after forty epochs with little clutter."""
    measured = room.measure(61, epochs=40, clutter_mean=1.0)
    engine = GaussianEngine(config_for(measured))
    state = engine.start(Prior.of(measured), None)
    for epoch in measured.epochs:
        state = engine.step(state, epoch, None)
    return state, engine.config


def then(state, config, buffer):
    """What today's map explains of a buffer."""
    best = state.hypotheses.best
    return associated_then(
        state.layout, state.hypotheses.mean[best], state.hypotheses.located[best],
        state.hypotheses.present[best], state.slots.confirmed, state.slots.owner, buffer,
        config.noise.range_std_m, MODEL.pair_radius_m, MODEL.beside_sigma, MODEL.leg_sigma,
    )  # fmt: skip


def test_old_paths_find_their_explanation(settled):
    """Paths noted as unexplained too early are recognised; clutter stays unexplained."""
    state, config = settled
    unassociated = state.buffer.unassociated
    forgotten = state.buffer._replace(unassociated=np.ones_like(unassociated))
    near, _ = then(state, config, forgotten)
    assert near[~unassociated].mean() > 0.9
    assert near[unassociated].mean() < 0.5


def test_legs_are_pieces_of_detected_paths(settled):
    """They begin at the agent or end at an anchor, and together are as long as their paths."""
    state, config = settled
    _, legs = then(state, config, state.buffer)
    mean = state.hypotheses.mean[state.hypotheses.best]
    anchors = [mean[state.layout.anchor_xy(k)] for k in range(2)]
    ends = np.min([np.linalg.norm(legs[:, 1] - place, axis=1) for place in anchors], axis=0)
    begins = np.linalg.norm(legs[:, None, 0] - state.buffer.track.position_m[None], axis=-1).min(axis=1)
    assert np.all((ends < 1e-9) | (begins < 1e-9))
    assert len(legs) > 100
    direct = (ends < 1e-9) & (begins < 1e-9)
    lengths = np.linalg.norm(legs[direct, 1] - legs[direct, 0], axis=1)
    gaps = np.abs(lengths[:, None] - np.sqrt(np.maximum(state.buffer.length_m**2 - 1.0, 0.0)))
    assert gaps.min(axis=1).max() < 0.5


def test_paths_beside_a_prediction_are_its_echoes(room):
    """Within the radius, or more where the prediction is uncertain, but never beyond the farthest."""
    mean, layout = state_of(room, room.track[40])
    length = predict_paths(mean[None], layout).length_m[0, 0, 0]  # the shortest of all
    gaps = np.array([0.1, 0.5, 0.7, 1.5, 2.9, 3.2])
    paths = path_table(np.stack([length - gaps, length - gaps]), 0.1, [6, 0])
    nobody, nothing = np.full(layout.slots, -1), np.zeros((2, 6))
    none, both = np.zeros(layout.slots, dtype=bool), np.ones(2, dtype=bool)
    for std, expected in ((0.0, [1, 1, 0, 0, 0, 0]), (0.5, [1, 1, 1, 1, 0, 0]), (5.0, [1, 1, 1, 1, 1, 0])):
        covariance = np.zeros((layout.size, layout.size))
        covariance[:2, :2] = std**2 * np.eye(2)
        found = associated_now(
            layout, mean, covariance, both, none, none, nobody, paths, nothing,
            MODEL.explained_probability, MODEL.pair_radius_m, MODEL.beside_sigma, MODEL.farthest_m,
        )  # fmt: skip
        assert found[0].astype(int).tolist() == expected
        assert not found[1].any()
    explained = nothing + 0.4
    found = associated_now(
        layout, mean, covariance, ~both, none, none, nobody, paths, explained,
        MODEL.explained_probability, MODEL.pair_radius_m, MODEL.beside_sigma, MODEL.farthest_m,
    )  # fmt: skip
    assert not found.any()  # of an anchor that stands nowhere nothing is explained
