"""Estimates of a mixture: against draws, in the estimator's frame."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import rotate
from estimator.measurements import GaussianVrp
from estimator.slam import GaussianConfig, estimate, start
from estimator.slam.gaussian.estimate import candidates
from estimator.slam.models.state_vector import THETA

CONFIG = GaussianConfig()
WALLS = np.array([[30.0, 12.0], [-6.0, 40.0]])


def mixed(weight=0.3):
    """Two hypotheses that differ in the agent and in one wall; the second lacks the anchor."""
    walls = [GaussianVrp(wall, 0.02 * np.eye(2)) for wall in WALLS]
    state = start(walls, ("a",), 28e9, CONFIG)
    one = state.hypotheses
    one.mean[0, :4], one.mean[0, THETA] = (3.0, 1.0, 0.5, 0.1), 0.05
    one.mean[0, state.layout.anchor(0)] = 9.0, -4.0, 1.0, 0.0
    one.covariance[0, :4, :4] = np.diag([0.1, 0.2, 0.01, 0.02])
    one.located[:] = True
    other = one.take([0])
    other.mean[0, 0] += 1.0
    other.mean[0, state.layout.wall(1)] += 8.0
    other.located[:] = False
    both = one.joined(other)._replace(log_weight=np.log([1.0 - weight, weight]))
    return state.but(hypotheses=both, log_evidence=-3.0)


def test_the_agent_is_the_mixtures_mean():
    """Mean and covariance of 300,000 draws of hypothesis, state and rotation."""
    state, rng = mixed(), np.random.default_rng(1)
    found = estimate(state, CONFIG)
    which = rng.choice(2, 300_000, p=[0.7, 0.3])
    index = [0, 1, 2, 3, THETA]
    covariance = state.hypotheses.covariance[0][np.ix_(index, index)]
    draws = state.hypotheses.mean[which][:, index] + rng.multivariate_normal(np.zeros(5), covariance, 300_000)
    turned = np.concatenate(
        [
            np.stack(
                [
                    np.cos(a := state.bearing_rad + draws[:, 4]) * draws[:, i] - np.sin(a) * draws[:, i + 1],
                    np.sin(a) * draws[:, i] + np.cos(a) * draws[:, i + 1],
                ],
                axis=1,
            )
            for i in (0, 2)
        ],
        axis=1,
    )
    np.testing.assert_allclose(found.agent_mean, turned.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(found.agent_covariance, np.cov(turned.T), atol=0.01)
    assert found.rotation_std_rad == pytest.approx(np.sqrt(covariance[4, 4]))
    assert found.log_evidence == -3.0
    assert found.hypotheses == 2


def test_hypotheses_that_have_a_wall_elsewhere_do_not_blur_it():
    """Its existence is the weight of those that agree; so is the anchor's."""
    state = mixed()
    found = estimate(state, CONFIG)
    assert found.wall_existence.tolist() == pytest.approx([1.0, 0.7])
    assert found.anchor_existence.tolist() == pytest.approx([0.7])
    wall = state.hypotheses.mean[0, state.layout.wall(1)]
    np.testing.assert_allclose(found.wall_mean_m[1], rotate(wall, state.bearing_rad + 0.05), atol=1e-9)
    assert np.trace(found.wall_covariance_m2[1]) < 1.0
    assert found.wall_id.tolist() == [0, 1]


def test_what_the_likeliest_lacks_is_not_told():
    """An anchor that it has not located, a wall that it does not have or that is tentative."""
    state = mixed(0.6)
    state.hypotheses.present[1, 0] = False
    found = estimate(state, CONFIG)
    assert not found.anchor_valid[0]
    assert np.isnan(found.anchor_mean_m[0]).all()
    assert found.wall_id.tolist() == [1]
    state.slots.confirmed[1] = False
    assert estimate(state, CONFIG).wall_id.size == 0


def test_candidates_are_the_hypotheses_by_weight():
    """The likeliest first, the unlikely not at all; each with its own walls."""
    state = mixed(0.3)
    state.hypotheses.present[1, 0] = False
    found = candidates(state)
    assert [round(each.weight, 9) for each in found] == [0.7, 0.3]
    assert [each.wall_id.tolist() for each in found] == [[0, 1], [1]]
    assert len(candidates(mixed(1e-4))) == 1
    assert len(candidates(state, most=1)) == 1
    turn = state.bearing_rad + 0.05
    np.testing.assert_allclose(found[1].agent_m, rotate(state.hypotheses.mean[1, :2], turn), atol=1e-12)


def test_clocks_and_heights_are_those_of_the_hypotheses_that_have_the_anchor():
    """Given where they are estimated; a height has no sign, and its deviation no pole at nothing."""
    state, config = mixed(), CONFIG.but(clock_bias_std_m=0.5, height2_std_m2=1.0)
    one, layout = state.hypotheses, state.layout
    one.mean[:, layout.height2(0)], one.mean[:, layout.bias(0)] = (4.0, 400.0), (0.3, 7.0)
    one.covariance[:, layout.height2(0), layout.height2(0)] = 0.16
    one.covariance[:, layout.bias(0), layout.bias(0)] = 0.01
    found = estimate(state, config)
    assert np.allclose(found.anchor_clock_m, [[0.3, 0.1]])
    assert np.allclose(found.anchor_height_m, [[2.0, 0.4 / (2.0 * 2.0)]])
    one.mean[0, layout.height2(0)] = -0.1
    ((height, std),) = estimate(state, config).anchor_height_m
    assert height == 0.0
    assert 0.0 < std < 1.0
    plain = estimate(state, CONFIG.but(height2_std_m2=0.0))
    assert plain.anchor_clock_m is None
    assert plain.anchor_height_m is None
