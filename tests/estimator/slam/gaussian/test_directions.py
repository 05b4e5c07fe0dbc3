"""Directions of arrival, sweeps on the way and clock bias, in whole runs and in detail."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam import GaussianEngine, Prior, epoch_rng, run_slam
from estimator.slam.gaussian.sweep_update import take_sweep
from estimator.slam.models.sweeps import predict_flashes
from estimator.slam.run import config_for


def last_error(result, room):
    """Position error at the end, metres."""
    return float(np.linalg.norm(result.agent_mean[-1, :2] - (room.track[-1] - room.track[0])))


@pytest.mark.parametrize(
    ("extra", "rotation"),
    [
        ({"azimuth_std_rad": np.deg2rad(1.0)}, (0.0, 1.5e-3)),
        ({"sweep_every": 10}, (0.0, 3.5e-3)),
        ({"azimuth_std_rad": np.deg2rad(1.0), "heading_held": False}, (6e-3, 9.5e-3)),
        ({"clock_bias_m": 5.0}, (6e-3, 9.5e-3)),
    ],
    ids=["azimuths", "sweeps", "azimuths without heading", "clock bias"],
)
def test_more_sensing_and_less_knowledge(room, extra, rotation):
    """What tells the rotation narrows it, what does not leaves it; nothing loses the run."""
    for seed in (60, 61):
        result = run_slam(room.measure(seed, **extra))
        low, high = rotation
        assert low < result.rotation_std_rad[-1] < high
        assert last_error(result, room) < 3.0 * np.sqrt(np.trace(result.agent_covariance[-1, :2, :2])) + 0.2
        assert last_error(result, room) < 2.0


def test_a_sweep_finds_a_wall_that_was_not_there(room):
    """A wall in view of a later sweep alone enters, is heard, and counts as found."""
    measured = room.measure(62, sweep_every=10)
    result = run_slam(measured)
    found = result.wall_mean_m[-1][result.wall_valid[-1]]
    assert np.linalg.norm(found - room.vrps[4], axis=1).min() < 3.0


@pytest.mark.parametrize(("sigma", "entered"), [(3.0, 0), (5.0, 1), (9.0, 1)])
def test_a_bad_flash_of_a_known_wall_is_no_new_wall(room, sigma, entered):
    """A flash off by 3 standard deviations corrects; one outside the gate is another wall's."""
    measured = room.measure(63, epochs=12)
    engine = GaussianEngine(config_for(measured))
    state = engine.start(Prior.of(measured), epoch_rng(0, -1))
    for epoch in measured.epochs:
        state = engine.step(state, epoch, epoch_rng(0, epoch.index))
    flash, jacobian = predict_flashes(state.hypotheses.mean[state.hypotheses.best], state.layout)
    noise = 0.2 * np.eye(2)
    spread = jacobian[0] @ state.hypotheses.covariance[state.hypotheses.best] @ jacobian[0].T + noise
    to_agent = rotation_matrix(state.bearing_rad)
    off = flash[0] + sigma * np.linalg.cholesky(spread)[:, 0]
    models = engine.models
    after, _ = take_sweep(
        state,
        [GaussianVrp(to_agent @ off, noise)],
        True,
        models.sweeps,
        models.corrections.most_turn_rad,
        models.visibility,
    )
    best = after.hypotheses.best
    walls = after.hypotheses.present[best].sum() - state.hypotheses.present[state.hypotheses.best].sum()
    assert walls == entered
    moved = np.linalg.norm(after.hypotheses.mean[best, :2] - state.hypotheses.mean[state.hypotheses.best, :2])
    assert (moved > 1e-6) == (sigma == 3.0)


def test_a_common_clock_stays_common(room):
    """However an anchor's start shifts its clock, the others shift with it, in every hypothesis."""
    measured = room.measure(3, clock_bias_m=10.0, epochs=3)
    engine = GaussianEngine(config_for(measured))
    state = engine.start(Prior.of(measured), epoch_rng(0, -1))
    for epoch in measured.epochs:
        state = engine.step(state, epoch, epoch_rng(0, epoch.index))
        biases = state.hypotheses.mean[:, [state.layout.bias(0), state.layout.bias(1)]]
        np.testing.assert_allclose(biases[:, 0], biases[:, 1], atol=1e-6)
