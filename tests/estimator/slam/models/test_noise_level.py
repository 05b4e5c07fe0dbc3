"""Noise levels: what is believed of claimed deviations, against samples and what they should give."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.noise_level import NoiseLevel, believed, first_levels, learned
from estimator.slam.models.state_vector import Layout
from estimator.waveform import SPEED_OF_LIGHT_M_S

LAYOUT = Layout(2, 1)
ACTIVE = np.array([[True, False, False]] * 2)  # lines of sight alone
VISIBLE = np.full((2, 3), 0.9)
CLUTTER = np.full(2, 0.02)
PLACES = np.array([[5.0, 0.0], [0.0, 8.0]])


def table(lengths, std=0.1):
    """The paths of an epoch, one list of lengths an anchor."""
    paths = tuple(
        AnchorPaths(np.array(own) / SPEED_OF_LIGHT_M_S, np.full(len(own), std / SPEED_OF_LIGHT_M_S))
        if own
        else AnchorPaths.none()
        for own in lengths
    )
    return stack_paths(Epoch(0, 0.0, paths), 6e9)


def taught(true_std, epochs=2000, alike_s=0.0, step_s=1.0, extra=(), seed=4):
    """Levels after epochs of ranges to a standing agent, claimed at 0.1 m; mean of the first's last 200."""
    rng = np.random.default_rng(seed)
    mean = np.zeros(LAYOUT.size)
    for k in range(2):
        mean[LAYOUT.anchor_xy(k)] = PLACES[k]
    mean[LAYOUT.walls] = 30.0, 0.0
    covariance = np.zeros((LAYOUT.size, LAYOUT.size))
    covariance[:2, :2] = 0.05**2 * np.eye(2)
    settings = NoiseLevel(level_memory=100.0, alike_s=alike_s)
    model, levels, told = settings.model, first_levels(2, settings.levels_weighed), []
    for t in range(epochs):
        off = 0.05 * rng.normal(size=2)
        lengths = np.linalg.norm(PLACES - off, axis=1) + true_std * rng.normal(size=2)
        paths = believed(table([[lengths[0], *extra], [lengths[1]]]), 0.01, levels, t * step_s, model)
        levels = learned(LAYOUT, mean, covariance, ACTIVE, VISIBLE, paths, CLUTTER, levels, t * step_s, model)
        told.append(levels.level[0])
    return levels, np.mean(told[-200:])


@pytest.mark.parametrize("true_std", [0.05, 0.1, 0.2, 0.3])
def test_the_level_is_the_true_variance_over_the_claimed(true_std):
    """Claims that are off by a factor of two or three are found out, within 25 % of the variance."""
    _, level = taught(true_std)
    assert level == pytest.approx((true_std / 0.1) ** 2, rel=0.25)


def test_the_level_has_bounds():
    """Ranges without noise make no certainty; clutter beside the line of sight teaches nothing."""
    assert taught(0.001)[1] == pytest.approx(NoiseLevel().least_level, abs=0.03)
    assert taught(0.1, extra=(9.0, 12.0))[1] == pytest.approx(1.0, rel=0.25)


def test_errors_that_are_alike_tell_what_one_does():
    """At 100 ranges a second, alike for half a second, each counts a hundredth; none is believed more."""
    model = NoiseLevel(alike_s=0.5).model
    levels = first_levels(2, 25)._replace(heard_s=np.array([9.99, -np.inf]), level=np.array([1.0, 4.0]))
    std = believed(table([[5.0], [8.0]]), 0.01, levels, 10.0, model).std_m[:, 0]
    np.testing.assert_allclose(std, [0.1 * 10.0, 0.1 * 2.0])
    late = believed(table([[5.0], [8.0]]), 0.01, levels, 12.0, model).std_m[:, 0]
    np.testing.assert_allclose(late, [0.1, 0.2])
    assert taught(0.02, alike_s=0.5, step_s=0.01)[1] == pytest.approx(1.0, abs=1e-3)


def test_without_memory_the_claim_is_believed():
    """Nothing is learnt, whatever comes."""
    levels = first_levels(2, 25)
    paths = table([[5.9], []])
    model = NoiseLevel(level_memory=0.0).model
    after = learned(
        LAYOUT,
        np.ones(LAYOUT.size),
        np.eye(LAYOUT.size),
        ACTIVE,
        VISIBLE,
        paths,
        CLUTTER,
        levels,
        3.0,
        model,
    )
    assert after.level.tolist() == [1.0, 1.0]
    assert after.heard_s.tolist() == [3.0, -np.inf]


def test_bounces_tell_the_level_too():
    """Where a wall is surely visible, its paths count as lines of sight do; where it is not, they do not."""
    mean = np.zeros(LAYOUT.size)
    for k in range(2):
        mean[LAYOUT.anchor_xy(k)] = PLACES[k]
    mean[LAYOUT.walls] = 30.0, 0.0
    levels, model = first_levels(2, 25), NoiseLevel(level_memory=100.0).model
    direct, bounce = 5.0, 30.0 - 5.0
    paths = table([[direct, bounce + 0.3], []])
    both = np.array([[True, True, False]] * 2)

    def level(visibility):
        seen = np.array([[0.9, visibility, 0.0]] * 2)
        covariance = np.zeros((LAYOUT.size, LAYOUT.size))
        return learned(LAYOUT, mean, covariance, both, seen, paths, CLUTTER, levels, 0.0, model).level[0]

    assert level(0.5) < 1.0  # an exact line of sight, and a bounce that nobody is sure of
    assert level(0.9) > 1.5  # an innovation of three standard deviations


def test_paths_tell_the_level_where_the_place_is_hardly_known():
    """Ten lengths of an epoch tell a place, and how they scatter about it."""
    rng = np.random.default_rng(5)
    layout, angle = Layout(10, 1), 0.6 * np.arange(10)
    mean = np.zeros(layout.size)
    places = np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle)], axis=1)
    for k in range(10):
        mean[layout.anchor_xy(k)] = places[k]
    mean[layout.walls] = 90.0, 0.0
    covariance = np.zeros((layout.size, layout.size))
    covariance[:2, :2] = np.eye(2)
    settings = NoiseLevel(level_memory=100.0)
    levels = first_levels(10, settings.levels_weighed)
    active, seen = np.array([[True, False, False]] * 10), np.full((10, 3), 0.9)
    for t in range(12):
        lengths = np.linalg.norm(places - rng.normal(size=2), axis=1) + 0.3 * rng.normal(size=10)
        paths = believed(table([[length] for length in lengths]), 0.01, levels, float(t), settings.model)
        levels = learned(
            layout, mean, covariance, active, seen, paths, np.full(10, 0.02), levels, float(t), settings.model
        )
    assert 3.0 < np.exp(np.log(levels.level).mean()) < 13.0  # the claim is 0.1 m: 9 is right
