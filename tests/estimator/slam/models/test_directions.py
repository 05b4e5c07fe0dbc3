"""Directions of arrival: common headings, densities, and corrections against a dense filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from estimator.slam.models import directions
from estimator.slam.models.features import sources
from estimator.slam.models.state_vector import THETA, Layout

LAYOUT = Layout(2, 2)
FEATURE = np.array([0, 1, 2, 0])
ANCHOR = np.array([0, 0, 1, 1])
STD = np.array([0.01, 0.02, 0.015, 0.01])


def gaussian(rng):
    """A mean with two anchors and two walls, and a small covariance."""
    mean = np.zeros(LAYOUT.size)
    mean[:2] = 3.0, -2.0
    mean[LAYOUT.anchor(0)], mean[LAYOUT.anchor(1)] = (20.0, 9.0, 1.0, 0.0), (-8.0, 15.0, 1.0, 0.0)
    mean[LAYOUT.wall(0)], mean[LAYOUT.wall(1)] = (60.0, 0.0), (4.0, -50.0)
    root = 0.02 * rng.normal(size=(LAYOUT.size, LAYOUT.size))
    return mean, root @ root.T


def updated(mean, covariance, azimuth, held, gate_sigma=4.0):
    """The Gaussian and the log density after some directions."""
    mean, covariance = mean.copy(), covariance.copy()
    source = sources(LAYOUT, mean, np.ones((2, LAYOUT.features), dtype=bool))
    log_density = directions.update_by_directions(
        LAYOUT, mean, covariance, source, ANCHOR, FEATURE, azimuth, STD, held, 0.05, gate_sigma
    )
    return mean, covariance, log_density


def dense(mean, jacobian, covariance, innovation):
    """A joint Kalman update, and the log density of its innovation."""
    noise = np.diag(STD**2)
    s = jacobian @ covariance @ jacobian.T + noise
    gain = covariance @ jacobian.T @ np.linalg.inv(s)
    after = covariance - gain @ s @ gain.T
    return mean + gain @ innovation, after, multivariate_normal(cov=s).logpdf(innovation)


def linearised(mean):
    """Directions of the four paths and their derivatives."""
    azimuth, jacobian = directions.predict_azimuths(mean[None], LAYOUT)
    return azimuth[0, ANCHOR, FEATURE], jacobian[0, ANCHOR, FEATURE]


def test_held_headings_correct_as_a_dense_filter_does():
    """Directions from the axes of the start are plain measurements; wrapped ones too."""
    rng = np.random.default_rng(1)
    mean, covariance = gaussian(rng)
    azimuth, jacobian = linearised(mean)
    innovation = STD * rng.normal(size=4)
    expected = dense(mean, jacobian, covariance, innovation)
    found = updated(mean, covariance, azimuth + innovation + 2.0 * np.pi, True)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-9)
    np.testing.assert_allclose(found[1], expected[1], atol=1e-10)
    assert found[2] == pytest.approx(expected[2] + 4 * np.log(2.0 * np.pi), abs=1e-6)


def test_an_unknown_heading_is_integrated_out():
    """Any turn of the agent gives the same correction, that of one more wide state; theta learns nothing."""
    rng = np.random.default_rng(2)
    mean, covariance = gaussian(rng)
    azimuth, jacobian = linearised(mean)
    innovation = STD * rng.normal(size=4)
    wide = np.zeros((LAYOUT.size + 1, LAYOUT.size + 1))
    wide[:-1, :-1], wide[-1, -1] = covariance, (2.0 * np.pi) ** 2 / 12.0
    columns = np.concatenate([jacobian, np.ones((4, 1))], axis=1)
    about = innovation - directions.common_heading(innovation, 0.05)  # the prior of the turn lies there
    expected = dense(np.append(mean, 0.0), columns, wide, about)
    for turn in (0.0, 2.3):
        found = updated(mean, covariance, azimuth + innovation + turn, False)
        np.testing.assert_allclose(found[0], expected[0][:-1], atol=1e-6)
        np.testing.assert_allclose(found[1], expected[1][:-1, :-1], atol=1e-8)
    before = np.sqrt(covariance[THETA, THETA])
    assert np.sqrt(found[1][THETA, THETA]) > 0.96 * before


def test_a_direction_off_the_common_heading_is_left_out():
    """One path taken for another's must not turn the rest."""
    mean, covariance = gaussian(np.random.default_rng(3))
    azimuth, _ = linearised(mean)
    wrong = azimuth.copy()
    wrong[3] += 1.0
    found, clean = updated(mean, covariance, wrong, False), updated(mean, covariance, azimuth, False)
    assert np.linalg.norm(found[0] - mean) < 1e-9 + np.linalg.norm(clean[0] - mean)
    held = updated(mean, covariance, wrong, False, gate_sigma=1e6)
    assert np.linalg.norm(held[0] - mean) > 1e-3


def test_the_common_heading_is_the_densest():
    """The mean of angles that straddle pi, whatever a minority says."""
    agreeing = np.array([3.13, -3.14, 3.15, 0.4, -1.0])
    heading = directions.common_heading(agreeing, 0.05)
    assert abs(directions.wrapped(heading - np.pi)) < 0.02


def test_the_ratio_is_a_density_over_that_of_any_direction():
    """Gating weighs directions by it."""
    assert directions.direction_ratio(0.03, 0.02**2) == pytest.approx(
        norm.pdf(0.03, scale=0.02) * 2.0 * np.pi
    )


def test_settings_name_what_is_wrong():
    """A heading from directions that agree on nothing has no meaning."""
    with pytest.raises(Exception, match=r"Directions.agree_rad: expected a positive number, got 0"):
        directions.Directions(agree_rad=0.0)
