"""The epoch update against a plain Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest
from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.layout import Layout
from scipy.stats import multivariate_normal

from estimator.slam.gaussian.update import correct
from tests.estimator.slam.test_features import state_of


def random_problem(rng, rows=3, size=6, count=4):
    """Random means, covariances and measurements."""
    root = rng.normal(size=(rows, size, size))
    covariance = root @ root.transpose(0, 2, 1)
    return (
        rng.normal(size=(rows, size)),
        covariance,
        rng.normal(size=(rows, count, size)),
        rng.normal(size=(rows, count)),
        rng.uniform(0.5, 2.0, size=(rows, count)),
    )


def test_kalman_is_the_textbook_update():
    """Means, covariances and evidence equal the information-form update and SciPy's density."""
    mean, covariance, jacobian, innovation, variance = random_problem(np.random.default_rng(4))
    new_mean, new_covariance, log_density = kalman(mean, covariance, jacobian, innovation, variance)
    for r in range(len(mean)):
        h, noise = jacobian[r], np.diag(variance[r])
        information = np.linalg.inv(covariance[r]) + h.T @ np.linalg.inv(noise) @ h
        posterior = np.linalg.inv(information)
        assert np.allclose(new_covariance[r], posterior, atol=1e-8)
        shift = posterior @ h.T @ np.linalg.inv(noise) @ innovation[r]
        assert np.allclose(new_mean[r], mean[r] + shift, atol=1e-8)
        s = h @ covariance[r] @ h.T + noise
        assert log_density[r] == pytest.approx(multivariate_normal(cov=s).logpdf(innovation[r]))


def test_unused_measurements_change_nothing():
    """A zero row with variance 1 / (2 pi) leaves the row and its evidence as they were."""
    mean, covariance, jacobian, innovation, variance = random_problem(np.random.default_rng(5))
    jacobian[0], innovation[0], variance[0] = 0.0, 0.0, 0.5 / np.pi
    new_mean, new_covariance, log_density = kalman(mean, covariance, jacobian, innovation, variance)
    assert np.allclose(new_mean[0], mean[0])
    assert np.allclose(new_covariance[0], covariance[0])
    assert log_density[0] == pytest.approx(0.0, abs=1e-12)


def test_clear_paths_are_taken_as_a_kalman_filter_would(room):
    """With well separated true paths the update equals one joint Kalman update."""
    mean, layout = state_of(room, room.track[20])
    rng = np.random.default_rng(6)
    covariance = np.zeros((layout.size, layout.size))
    covariance[:2, :2] = 0.04 * np.eye(2)
    active = np.zeros((1, 2, layout.features), dtype=bool)
    active[:, :, [0, 4]] = True  # line of sight and the wall y = 0
    prediction = predict_paths(mean[None], layout)
    length = prediction.length_m[0][:, [0, 4]] + rng.normal(scale=0.05, size=(2, 2))
    config = GaussianConfig(range_std_m=0.1)
    done = correct(
        mean[None],
        covariance[None],
        np.full((1, 2, layout.features), 0.9),
        active,
        PathTable(length, np.full((2, 2), 0.05), np.full((2, 2), np.nan), np.ones((2, 2), dtype=bool)),
        layout,
        config,
    )
    jacobian = prediction.jacobian[:, :, [0, 4]].reshape(1, 4, -1)
    innovation = (length - prediction.length_m[0][:, [0, 4]]).reshape(1, 4)
    expected = kalman(mean[None], covariance[None], jacobian, innovation, np.full((1, 4), 0.01))
    assert np.allclose(done.mean, expected[0], atol=1e-9)
    assert np.allclose(done.covariance, expected[1], atol=1e-12)
    odds = 4 * np.log(0.9 * config.detection_probability / config.clutter_density)
    assert done.log_evidence[0] == pytest.approx(odds + expected[2][0])
    assert np.all(done.explained == 1.0)


def test_a_missed_feature_is_less_visible(room):
    """Nothing heard: visibility falls by Bayes' rule, the Gaussian stays."""
    mean, layout = state_of(room, room.track[20])
    active = np.zeros((1, 2, layout.features), dtype=bool)
    active[:, :, 0] = True
    none = np.zeros((2, 1), dtype=bool)
    done = correct(
        mean[None],
        np.eye(layout.size)[None],
        np.full((1, 2, layout.features), 0.8),
        active,
        PathTable(np.ones((2, 1)), np.ones((2, 1)), np.ones((2, 1)), none),
        layout,
        GaussianConfig(),
    )
    assert np.allclose(done.visibility[:, :, 0], 0.8 * 0.05 / (0.8 * 0.05 + 0.2))
    assert np.all(done.visibility[:, :, 1:] == 0.8)
    assert np.array_equal(done.mean[0], mean)
    assert done.log_evidence[0] == pytest.approx(2 * np.log(1 - 0.8 * 0.95))


def test_every_doubt_of_an_epoch_is_decided_both_ways():
    """Two lines of sight missed, clutter near each: a row remains that took neither, and stays put."""
    layout = Layout(2, 0, shared=False)
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    mean[layout.anchor(0)], mean[layout.anchor(1)] = (50.0, 0.0, 0.0, 0.0), (0.0, 30.0, 0.0, 0.0)
    covariance[:2, :2] = np.eye(2)
    length = np.array([[51.5], [28.2]])  # 1.5 and 1.8 m from where the lines of sight are expected
    paths = PathTable(length, np.full((2, 1), 0.1), np.full((2, 1), np.nan), np.ones((2, 1), dtype=bool))
    everywhere = np.ones((1, 2, 1))
    config = GaussianConfig(range_std_m=0.1, region_m=180.0)
    done = correct(
        mean[None], covariance[None], 0.9 * everywhere, everywhere > 0.0, paths, layout, config
    )  # fmt: skip
    took = done.heard[..., 0] > 0.5
    assert sorted(took.tolist()) == [[False, False], [False, True], [True, False], [True, True]]
    neither = int(np.flatnonzero(~took.any(axis=1))[0])
    np.testing.assert_allclose(done.mean[neither, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(done.covariance[neither], covariance, atol=1e-9)
    both = int(np.flatnonzero(took.all(axis=1))[0])
    np.testing.assert_allclose(done.mean[both, :2], [-1.485, 1.78], atol=0.05)
    assert done.log_evidence[both] > done.log_evidence[neither]
