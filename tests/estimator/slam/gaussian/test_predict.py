"""The step to the next epoch against dense matrices: by the motion model, and by odometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, Odometry
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.engine import step
from estimator.slam.gaussian.predict import Fading, move_by_odometry, move_on, predict
from estimator.slam.gaussian.start import start
from estimator.slam.models.clocks import Clocks
from estimator.slam.models.motion import Motion, process_noise, transition
from estimator.slam.models.state_vector import HEADING, Layout
from tests.estimator.slam.gaussian.test_update import one_hypothesis

FADING = Fading(0.5, Clocks().model, 0.02, 0.1, np.array([True]))


def some(seed, layout):
    """A hypothesis with a full covariance."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(layout.size, layout.size))
    return one_hypothesis(layout, rng.normal(size=layout.size), root @ root.T, 0.7, [True])


def test_prediction_moves_the_agent_and_visibility():
    """A dense prediction of the motion, and the Markov chain of appearing and vanishing."""
    layout = Layout(1, 1)
    hypotheses = some(2, layout)
    after = move_on(layout, hypotheses, Motion(acceleration_variance=0.2).driving(0.5), 0.3, FADING)
    still = layout.size - 4
    a = block_diag(transition(0.5), np.eye(still))
    q = block_diag(process_noise(0.5, 0.2), np.zeros((still, still)))
    q[HEADING, HEADING] = 0.3
    np.testing.assert_allclose(after.mean[0], a @ hypotheses.mean[0], atol=1e-12)
    np.testing.assert_allclose(after.covariance[0], a @ hypotheses.covariance[0] @ a.T + q, atol=1e-10)
    assert np.allclose(after.visibility, 0.9 * 0.7 + 0.02 * 0.3)
    assert np.all(hypotheses.visibility == 0.7)


def moved(vector, displacement, turn, step_s):
    """The state after a step by odometry: the function itself, which the filter linearises."""
    after = vector.copy()
    cos, sin = np.cos(vector[HEADING]), np.sin(vector[HEADING])
    way = np.array(
        [cos * displacement[0] - sin * displacement[1], sin * displacement[0] + cos * displacement[1]]
    )
    after[0:2] += way
    after[2:4] = way / step_s
    after[HEADING] += turn
    return after


def test_odometry_is_a_dense_extended_kalman_prediction():
    """Derivatives by complex steps of state and odometry, in dense matrices."""
    layout = Layout(1, 2)
    hypotheses = some(3, layout)
    root = np.random.default_rng(4).normal(size=(3, 3)) * 0.1
    told = Odometry([0.8, -0.3], 0.4, root @ root.T)
    after = move_by_odometry(layout, hypotheses, told.displacement_m, told.turn_rad, told.covariance, FADING)
    mean, n, h = hypotheses.mean[0], layout.size, 1e-30
    at = np.concatenate([mean, told.displacement_m, [told.turn_rad]]).astype(complex)
    jacobian = np.empty((n, n + 3))
    for i in range(n + 3):
        nudged = at.copy()
        nudged[i] += 1j * h
        jacobian[:, i] = moved(nudged[:n], nudged[n : n + 2], nudged[n + 2], 0.5).imag / h
    both = block_diag(hypotheses.covariance[0], told.covariance)
    np.testing.assert_allclose(
        after.mean[0], moved(mean, told.displacement_m, told.turn_rad, 0.5), atol=1e-12
    )
    np.testing.assert_allclose(after.covariance[0], jacobian @ both @ jacobian.T, atol=1e-10)
    assert np.allclose(after.visibility, 0.9 * 0.7 + 0.02 * 0.3)


def test_with_odometry_nothing_turns_by_itself():
    """A turn branch doubles hypotheses only where nobody measured the turn."""
    layout, config = Layout(1, 1), GaussianConfig()
    paths = (AnchorPaths.none(),)
    told = Odometry([0.5, 0.0], 1.6, np.diag([0.01, 0.01, 0.001]))
    without = predict(layout, some(5, layout), Epoch(1, 1.0, paths), 1.0, True, config)
    with_it = predict(layout, some(5, layout), Epoch(1, 1.0, paths, odometry=told), 1.0, True, config)
    assert (without.number, with_it.number) == (2, 1)


def test_exact_odometry_leads_the_agent_round_a_corner():
    """A square walked by exact odometry alone ends where it began; the map's bearing error turns all of it.

    The reference wall's bearing is 0.6 rad, so that the gauge frame is turned against the estimator's.
    """
    wall = GaussianVrp(20.0 * np.array([np.cos(0.6), np.sin(0.6)]), 1e-4 * np.eye(2))
    config = GaussianConfig()
    state = step(start([wall], ["a"], 28e9, config), Epoch(0, 0.0, (AnchorPaths.none(),)), config)
    quarter = 0.5 * np.pi
    places, spread = [], []
    for index, turn in enumerate((0.0, quarter, 0.0, quarter, 0.0, quarter, 0.0, quarter), 1):
        told = Odometry([0.0 if turn else 2.0, 0.0], turn, np.zeros((3, 3)))
        state = step(state, Epoch(index, float(index), (AnchorPaths.none(),), odometry=told), config)
        places.append(state.hypotheses.mean[0, :2])
        spread.append(state.hypotheses.covariance[0, :2, :2])
    to_estimator = np.array([[np.cos(0.6), -np.sin(0.6)], [np.sin(0.6), np.cos(0.6)]])
    walked = np.array(places)[[0, 2, 4, 6]] @ to_estimator.T
    np.testing.assert_allclose(walked, [[2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]], atol=1e-9)
    assert state.hypotheses.mean[0, HEADING] == pytest.approx(2 * np.pi - 0.6)
    # half a milliradian of bearing moves the far corner across, by its distance; back at RP it moves nothing
    across = np.array([-2.0, 2.0]) / np.sqrt(8.0) @ to_estimator
    assert across @ spread[3] @ across == pytest.approx(8.0 * (0.01 / 20.0) ** 2, rel=1e-3)
    assert np.abs(spread[7]).max() < 1e-9
