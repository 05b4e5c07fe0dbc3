"""Sweeps on the way: matched, taken as a dense filter takes them, and what is not known enters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig, start
from estimator.slam.gaussian.sweep_update import take_sweep
from estimator.slam.models.state_vector import THETA
from estimator.slam.models.sweeps import predict_flashes

WALLS = np.array([[40.0, 3.0], [-24.0, 1.0], [2.0, 30.0]])
NOISE = np.array([[0.02, 0.005], [0.005, 0.03]])
CONFIG = GaussianConfig()


def some_state():
    """Three walls, known to a decimetre or two, and an agent that has walked."""
    state = start([GaussianVrp(wall, 0.02 * np.eye(2)) for wall in WALLS], ("a",), 28e9, CONFIG)
    rng = np.random.default_rng(1)
    root = 0.05 * rng.normal(size=(5, 5))
    state.hypotheses.mean[0, :5] = 2.0, -1.0, 0.5, 0.0, 0.004
    state.hypotheses.covariance[0, :5, :5] += root @ root.T
    return state.but(epoch=7)


def flashes(state):
    """Predicted flashes and their derivatives, of the only hypothesis, in the gauge frame's axes."""
    return predict_flashes(state.hypotheses.mean[0], state.layout)


def swept(state, seen, held=True, turn=0.0, most_turn=0.0):
    """The state after flashes, given in the gauge frame's axes; the agent's are turned by ``turn``."""
    to_agent = rotation_matrix(state.bearing_rad + turn)
    sweep = [GaussianVrp(to_agent @ flash, to_agent @ NOISE @ to_agent.T) for flash in seen]
    return take_sweep(state, sweep, held, CONFIG.sweeps, most_turn, CONFIG.visibility)[0]


def dense(state, innovation, heading):
    """A joint Kalman update by all flashes, the unknown heading as one more state."""
    flash, jacobian = flashes(state)
    h = jacobian.reshape(6, -1)
    n = h.shape[1]
    mean, p = np.append(state.hypotheses.mean[0], 0.0), np.zeros((n + 1, n + 1))
    p[:n, :n] = state.hypotheses.covariance[0]
    h = np.concatenate([h, np.stack([-flash[:, 1], flash[:, 0]], axis=1).reshape(6, 1) * heading], axis=1)
    p[n, n] = (2.0 * np.pi) ** 2 / 12.0
    s = h @ p @ h.T + np.kron(np.eye(3), NOISE)
    gain = p @ h.T @ np.linalg.inv(s)
    log_density = multivariate_normal(cov=s).logpdf(innovation)
    return (mean + gain @ innovation)[:n], (p - gain @ s @ gain.T)[:n, :n], log_density


@pytest.mark.parametrize("held", [True, False])
def test_a_sweep_is_a_joint_update(held):
    """Mean, covariance and evidence of correlated noise; an unknown heading is integrated out.

    Flashes are taken one by one, each linearised anew: the difference is that of the linearisation.
    """
    state = some_state()
    innovation = 0.1 * np.random.default_rng(2).normal(size=6)
    seen = flashes(state)[0] + innovation.reshape(3, 2)
    after = swept(state, seen[[2, 0, 1]], held)
    mean, covariance, log_density = dense(state, innovation, 0.0 if held else 1.0)
    np.testing.assert_allclose(after.hypotheses.mean[0], mean, atol=8e-3)
    np.testing.assert_allclose(after.hypotheses.covariance[0], covariance, atol=1e-3)
    assert after.log_evidence == pytest.approx(log_density, abs=0.1)
    assert after.hypotheses.log_weight[0] > -0.01  # a rival whose match is another one may stand beside it
    assert not np.array_equal(state.hypotheses.mean, after.hypotheses.mean)
    assert after.hypotheses.present[0].tolist()[:3] == [True, True, True]


def test_any_heading_gives_the_same_correction():
    """An agent that turned tells the same distances and angles between walls."""
    state = some_state()
    seen = flashes(state)[0] + 0.1 * np.random.default_rng(3).normal(size=(3, 2))
    results = [swept(state, seen, False, turn).hypotheses for turn in (0.0, 1.9, -2.8)]
    for other in results[1:]:
        np.testing.assert_allclose(other.mean, results[0].mean, atol=1e-6)
        # the noise was turned along: its ellipse is another, which shows in the covariance a little
        np.testing.assert_allclose(other.covariance, results[0].covariance, atol=1e-4)


def test_a_hypothesis_that_explains_a_flash_is_the_likelier():
    """Beside it one that lacks the wall: the sweep shows the wall, and must not speak against it."""
    state = some_state()
    both = state.hypotheses.joined(state.hypotheses)
    both.present[1, 2] = False
    after = swept(state.but(hypotheses=both), flashes(state)[0]).hypotheses
    with_wall = after.log_weight[after.present[:, 2]].max()
    assert with_wall > after.log_weight[~after.present[:, 2]].max()


def test_flashes_are_matched_one_to_one():
    """Of two flashes at one wall the nearer is its own; the other corrects nothing, and is a new wall's."""
    state = some_state()
    flash = flashes(state)[0]
    alone = swept(state, [flash[0]])
    both = swept(state, [flash[0] + [0.5, 0.3], flash[0]])
    np.testing.assert_allclose(
        both.hypotheses.mean[0, : state.layout.size],
        alone.hypotheses.mean[0, : state.layout.size],
        atol=1e-12,
    )
    assert both.hypotheses.present[0].sum() == 4


@pytest.mark.parametrize("held", [True, False])
def test_a_flash_of_no_known_wall_is_a_new_one(held):
    """It enters all hypotheses, tentative, where its flash shows it; not where the heading is not held."""
    state = some_state()
    agent = state.hypotheses.mean[0, :2]
    wall = np.array([-5.0, -44.0])
    image = agent + (1.0 - 2.0 * (agent @ wall) / (wall @ wall)) * wall
    turn = rotation_matrix(float(state.hypotheses.mean[0, THETA]))
    after = swept(state, [*flashes(state)[0], turn @ (image - agent)], held)
    if not held:
        assert after.layout.slots == 3
        return
    assert after.slots.wall_id.tolist() == [0, 1, 2, 3]
    assert after.slots.born[3] == 7
    assert not after.slots.confirmed[3]
    found = after.hypotheses
    np.testing.assert_allclose(found.mean[0, after.layout.wall(3)], wall, atol=0.3)
    assert np.linalg.eigvalsh(found.covariance[0]).min() > -1e-9
    # its flash is predicted with the noise of a flash beside what is known
    _, jacobian = predict_flashes(found.mean[0], after.layout)
    spread = jacobian[3] @ found.covariance[0] @ jacobian[3].T
    np.testing.assert_allclose(spread, NOISE, atol=2e-3)


def test_no_sweep_changes_nothing():
    """An epoch without flashes leaves the state itself."""
    state = some_state()
    assert swept(state, []) is state


def test_flashes_tell_where_a_wall_reflects():
    """The feet of the agent on the wall, one after the other."""
    state = some_state()
    once = swept(state, flashes(state)[0]).slots.extent_m
    walls = state.hypotheses.mean[0, state.layout.walls].reshape(-1, 2)
    along = np.stack([-walls[:, 1], walls[:, 0]], axis=1) / np.linalg.norm(walls, axis=1)[:, None]
    foot = along @ state.hypotheses.mean[0, :2]
    np.testing.assert_allclose(once[:, 0], np.minimum(foot, 0.0), atol=1e-9)
    np.testing.assert_allclose(once[:, 1], np.maximum(foot, 0.0), atol=1e-9)


def test_range_and_direction_are_believed_apart():
    """Residuals in range alone make variances in range alone larger."""
    state = some_state()
    seen = flashes(state)[0]
    rng = np.random.default_rng(4)
    for _ in range(60):
        size = np.linalg.norm(seen, axis=1)[:, None]
        sweep = seen + 0.6 * rng.normal(size=(3, 1)) * seen / size
        kept = swept(state, sweep).echo_residuals
        state = some_state().but(echo_residuals=kept)
    scale = state.echo_residuals[:, 0] / state.echo_residuals[:, 1]
    assert scale[0] > 3.0
    assert scale[1] < 0.5
