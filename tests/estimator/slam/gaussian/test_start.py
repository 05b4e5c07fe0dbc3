"""The state before the first epoch."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig
from estimator.slam.gaussian.estimate import estimate
from estimator.slam.gaussian.start import start, state_of
from estimator.slam.models.state_vector import THETA, Layout


def walls_of(rng=None, turn=0.0):
    """Three walls, perturbed by draws of their own covariance if a generator is given."""
    means = np.array([[30.0, 4.0], [-6.0, 40.0], [-80.0, -3.0]])
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    roots = [np.array([[0.2, 0.0], [0.1, 0.3]]), 0.3 * np.eye(2), np.array([[0.5, 0.1], [0.0, 0.2]])]
    result = []
    for mean, root in zip(means, roots, strict=True):
        noise = root @ rng.normal(size=2) if rng is not None else 0.0
        result.append(GaussianVrp(rotation @ (mean + noise), rotation @ root @ root.T @ rotation.T))
    return result


def test_the_walls_come_back():
    """Turned back to the estimator's frame, the start has the walls it was given."""
    config = GaussianConfig()
    state = start(walls_of(), ("a",), 28e9, config)
    found = estimate(state, config)
    for wall in walls_of():
        j = int(np.argmin(np.linalg.norm(found.wall_mean_m - wall.mean_m, axis=1)))
        assert np.allclose(found.wall_mean_m[j], wall.mean_m, atol=1e-9)
        assert np.allclose(found.wall_covariance_m2[j], wall.covariance_m2, atol=1e-9)
    assert np.all(found.agent_mean == 0.0)
    assert not found.anchor_valid.any()


def test_gauge_covariance_is_that_of_sampled_walls():
    """Theta and the VRPs in the gauge frame have the covariance of 5,000 sampled starts."""
    rng = np.random.default_rng(7)
    config = GaussianConfig()
    state = start(walls_of(), ("a",), 28e9, config)
    layout, draws = state.layout, 5_000
    norms = np.linalg.norm([wall.mean_m for wall in walls_of()], axis=1)
    in_slots = np.linalg.norm(state.hypotheses.mean[0, layout.walls].reshape(-1, 2), axis=1)
    order = [int(np.argmin(np.abs(norms - norm))) for norm in in_slots]  # wall in each slot
    samples = np.empty((draws, 1 + 2 * 3))
    for n in range(draws):
        walls = walls_of(rng)
        means = np.array([walls[i].mean_m for i in order])
        bearing = np.arctan2(means[0, 1], means[0, 0])
        c, s = np.cos(bearing), np.sin(bearing)
        samples[n, 0] = bearing - state.bearing_rad
        samples[n, 1:] = (means @ np.array([[c, -s], [s, c]])).ravel()
    index = [THETA, *range(layout.walls.start, layout.walls.stop)]
    claimed = state.hypotheses.covariance[0][np.ix_(index, index)]
    sampled = np.cov(samples.T)
    scale = np.sqrt(np.outer(np.diag(claimed), np.diag(claimed))) + 1e-9
    assert np.abs((sampled - claimed) / scale).max() < 5.0 / np.sqrt(draws) + 0.01  # 0.01: curvature


def test_the_reference_wall_has_no_free_bearing():
    """The gauge frame's x axis points at the reference wall, without uncertainty across."""
    state = start(walls_of(), ("a", "b"), 28e9, GaussianConfig())
    across = state.layout.wall(0).start + 1
    assert state.hypotheses.mean[0, across] == 0.0
    assert np.all(state.hypotheses.covariance[0, across] == 0.0)
    assert np.all(state.hypotheses.covariance[0, :, across] == 0.0)


def test_a_start_needs_walls_and_anchors():
    """Without a wall or an anchor there is an error that says so."""
    with pytest.raises(
        InputError, match="sensed at the start, sweeps, or known anchors, got 1 anchors and 0 walls"
    ):
        start([], ("a",), 28e9, GaussianConfig())
    with pytest.raises(InputError, match="got 0 anchors and 3 walls"):
        start(walls_of(), (), 28e9, GaussianConfig())


def test_known_anchors_fix_the_frame():
    """With known anchors nothing turns: theta, the anchors and their frame are certain, walls as sensed."""
    anchors = np.array([[3.0, 4.0], [-5.0, 1.0]])
    state = start(walls_of(), ("a", "b"), 28e9, GaussianConfig(), anchors)
    layout, mean, covariance = state.layout, state.hypotheses.mean[0], state.hypotheses.covariance[0]
    assert state.bearing_rad == 0.0
    assert state.hypotheses.located.all()
    assert covariance[THETA, THETA] == 0.0
    for k in range(2):
        np.testing.assert_array_equal(mean[layout.anchor_xy(k)], anchors[k])
        assert not covariance[layout.anchor_xy(k)].any()
    sensed = sorted((tuple(wall.mean_m), wall.covariance_m2) for wall in walls_of())
    slots = sorted(
        (tuple(mean[layout.wall(s)]), covariance[layout.wall(s), layout.wall(s)]) for s in range(layout.slots)
    )
    for (place, spread), (found, believed) in zip(sensed, slots, strict=True):
        np.testing.assert_allclose(found, place)
        np.testing.assert_allclose(believed, spread)
    nothing = start([], ("a", "b"), 28e9, GaussianConfig(), anchors)
    assert nothing.layout.slots == 0


def test_a_state_of_a_given_gaussian():
    """What is known otherwise (another run, a plan) is taken as it is; its walls count as found."""
    layout = Layout(1, 2)
    rng = np.random.default_rng(1)
    mean, covariance = rng.normal(size=layout.size), np.eye(layout.size)
    located = np.array([True])
    state = state_of(layout, mean, covariance, ("a",), located, 6e9, GaussianConfig(), 0.4)
    assert state.layout == layout
    assert np.array_equal(state.hypotheses.mean[0], mean)
    assert state.slots.confirmed.all()
    assert state.epoch == -1
    assert state.bearing_rad == 0.4
    assert state.next_wall_id == 2
    assert state.buffer.epochs == 0


def test_without_a_wall_the_first_sweep_begins_the_map():
    """The frame is then the estimator's own: theta is certain, no wall is there yet."""
    state = start([], ("a",), 28e9, GaussianConfig(), sweeps=True)
    assert state.bearing_rad == 0.0
    assert state.layout.slots == 0
    assert np.all(state.hypotheses.covariance[0, THETA] == 0.0)
