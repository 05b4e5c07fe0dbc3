"""The epoch update against a dense Kalman filter and Bayes' rule."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.predict import Fading, move_on
from estimator.slam.gaussian.update import update_hypotheses
from estimator.slam.models.clocks import Clocks
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.motion import Motion
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import Layout
from tests.estimator.slam.models.test_path_lengths import state_of


def path_table(length, std, number=None, asked=None):
    """Paths (K, M) without powers or directions."""
    length = np.asarray(length, dtype=float)
    count = np.full(len(length), length.shape[1]) if number is None else np.asarray(number)
    shape = length.shape
    nothing, never = np.full(shape, np.nan), np.full(shape, np.inf)
    asked = np.ones(len(length), dtype=bool) if asked is None else np.array(asked)
    return EpochPaths(count, length, np.full(shape, std), nothing, np.zeros(shape), never, False, asked)


def one_hypothesis(layout, mean, covariance, visibility, present):
    """A single hypothesis that has located all anchors."""
    return Hypotheses(
        np.zeros(1),
        mean[None].copy(),
        covariance[None].copy(),
        np.ones((1, layout.anchors), dtype=bool),
        np.asarray(present, dtype=bool)[None],
        np.full((1, layout.anchors, layout.features), visibility),
        np.zeros((1, layout.slots), dtype=np.int64),
    )


def taken(layout, hypotheses, paths, config, owner=None):
    """The hypotheses after an epoch of paths."""
    return update_hypotheses(
        layout,
        *config.kernels,
        hypotheses,
        np.ones(layout.slots, dtype=bool),
        np.full(layout.slots, -1) if owner is None else owner,
        paths,
        np.full(layout.anchors, config.noise.clutter_density),
    )


def test_clear_paths_are_taken_as_a_kalman_filter_would(room):
    """With well separated true paths the update is one joint Kalman update, its evidence included."""
    mean, layout = state_of(room, room.track[20])
    rng = np.random.default_rng(6)
    covariance = np.zeros((layout.size, layout.size))
    covariance[:2, :2] = 0.04 * np.eye(2)
    present = np.arange(layout.slots) == 3  # the wall y = 0
    prediction = predict_paths(mean[None], layout)
    length = prediction.length_m[0][:, [0, 4]] + rng.normal(scale=0.05, size=(2, 2))
    config = GaussianConfig.of(range_std_m=0.1, level_memory=0.0)
    done = taken(
        layout, one_hypothesis(layout, mean, covariance, 0.9, present), path_table(length, 0.05), config
    )
    jacobian = prediction.jacobian[0][:, [0, 4]].reshape(4, -1)
    innovation = (length - prediction.length_m[0][:, [0, 4]]).ravel()
    s = jacobian @ covariance @ jacobian.T + 0.01 * np.eye(4)
    gain = covariance @ jacobian.T @ np.linalg.inv(s)
    after = done.hypotheses
    np.testing.assert_allclose(after.mean[0], mean + gain @ innovation, atol=1e-9)
    np.testing.assert_allclose(after.covariance[0], covariance - gain @ s @ gain.T, atol=1e-12)
    odds = 4 * np.log(0.9 * config.noise.detection_probability / config.noise.clutter_density)
    expected = odds + multivariate_normal(cov=s).logpdf(innovation)
    assert after.log_weight[0] == pytest.approx(expected)
    assert np.all(done.explained == 1.0)
    assert done.parent.tolist() == [0]
    assert after.support[0].tolist() == [0, 0, 0, 1, 0, 0]


def test_a_missed_feature_is_less_visible(room):
    """Nothing heard: visibility falls by Bayes' rule, the Gaussian stays."""
    mean, layout = state_of(room, room.track[20])
    hypotheses = one_hypothesis(layout, mean, np.eye(layout.size), 0.8, np.zeros(layout.slots))
    done = taken(layout, hypotheses, path_table(np.ones((2, 1)), 1.0, [0, 0]), GaussianConfig())
    after = done.hypotheses
    assert np.allclose(after.visibility[0, :, 0], 0.8 * 0.05 / (0.8 * 0.05 + 0.2))
    assert np.all(after.visibility[0, :, 1:] == 0.8)
    assert np.array_equal(after.mean[0], mean)
    assert np.array_equal(after.covariance[0], np.eye(layout.size))
    assert after.log_weight[0] == pytest.approx(2 * np.log(1 - 0.8 * 0.95))


def test_an_anchor_that_was_not_asked_keeps_its_visibility():
    """Neither time nor silence tells anything of it; of the one that was asked, silence does."""
    layout = Layout(2, 1)
    mean = np.zeros(layout.size)
    mean[layout.anchor_xy(0)], mean[layout.anchor_xy(1)] = (5.0, 1.0), (1.0, 5.0)
    mean[layout.walls] = 12.0, 0.0
    before = one_hypothesis(layout, mean, 0.01 * np.eye(layout.size), 0.7, [True])
    asked = np.array([True, False])
    fading = Fading(0.5, Clocks().model, 0.02, 0.1, asked)
    after = move_on(layout, before, Motion().driving(0.5), 0.0, fading)
    assert np.all(after.visibility[0, 1] == 0.7)
    assert np.all(after.visibility[0, 0] != 0.7)
    done = taken(layout, before, path_table(np.ones((2, 1)), 0.1, [0, 0], asked), GaussianConfig())
    assert np.all(done.hypotheses.visibility[0, 1] == 0.7)
    assert np.all(done.hypotheses.visibility[0, 0, :2] < 0.7)
    silence = 2 * np.log(1.0 - 0.7 * GaussianConfig().noise.detection_probability)
    assert done.hypotheses.log_weight[0] == pytest.approx(silence)


def test_hypotheses_do_not_touch_each_other(room):
    """The update of two hypotheses together is that of each alone."""
    mean, layout = state_of(room, room.track[20])
    covariance = np.zeros((layout.size, layout.size))
    covariance[:2, :2] = 0.04 * np.eye(2)
    config = GaussianConfig.of(range_std_m=0.1)
    shifted = mean.copy()
    shifted[0] += 0.4
    length = predict_paths(mean[None], layout).length_m[0][:, [0, 2, 4]]
    length = np.concatenate([length, length[:, :1] + 0.5], axis=1)
    paths = path_table(length, 0.1)
    present = np.ones(layout.slots)
    each = [one_hypothesis(layout, m, covariance, 0.9, present) for m in (mean, shifted)]
    alone = [taken(layout, one, paths, config).hypotheses for one in each]
    both = taken(layout, each[0].joined(each[1]), paths, config)
    joined = alone[0].joined(alone[1])
    for name in Hypotheses._fields:
        np.testing.assert_array_equal(getattr(both.hypotheses, name), getattr(joined, name))
    assert np.bincount(both.parent).tolist() == [one.number for one in alone]
