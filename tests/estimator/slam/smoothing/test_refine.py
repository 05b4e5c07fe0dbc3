"""Whole runs of the filter, associated again and smoothed."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import rotate
from estimator.measurements import AnchorPaths
from estimator.slam import run_slam
from estimator.slam.models.visibility import Visibility
from estimator.slam.run import config_for
from estimator.slam.smoothing.association import visibility
from estimator.slam.smoothing.refine import RefineConfig, refine
from estimator.waveform import SPEED_OF_LIGHT_M_S


@pytest.fixture(scope="module")
def filtered(room):
    """Two runs: measurements, and what the filter made of them."""
    sets = [room.measure(seed) for seed in (61, 62)]
    return [(measurements, run_slam(measurements)) for measurements in sets]


def derotated(result, room) -> np.ndarray:
    """Distances (T,) from the true track after the best rotation."""
    track, true = result.agent_mean[:, :2], room.track - room.track[0]
    turn = np.arctan2(np.sum(true[:, 0] * track[:, 1] - true[:, 1] * track[:, 0]), np.sum(true * track))
    return np.linalg.norm(rotate(track, -float(turn)) - true, axis=1)


def test_smoothed_runs_are_better_and_honest(room, filtered):
    """Less error over the whole track than the filter's, errors that fit the covariances, the same walls."""
    for measurements, result in filtered:
        smoothed = refine(measurements, result)
        before, after = derotated(result, room), derotated(smoothed, room)
        assert np.sqrt(np.mean(after**2)) < 0.9 * np.sqrt(np.mean(before**2))
        assert after.max() < 0.5
        np.testing.assert_array_equal(smoothed.wall_id, result.wall_id[result.wall_valid[-1]])
        assert np.all(smoothed.wall_valid)
        assert np.all(smoothed.anchor_valid)
        for t in (60, 150, 235):
            error = smoothed.agent_mean[t, :2] - (room.track[t] - room.track[0])
            covariance = smoothed.agent_covariance[t, :2, :2]
            assert error @ np.linalg.solve(covariance, error) < 13.8  # 99.9 % of chi-square with 2
        distance = np.linalg.norm(smoothed.wall_mean_m[-1][:, None] - room.vrps[None], axis=-1)
        assert sorted(np.argmin(distance, axis=1)) == [0, 1, 2, 3, 4]


def test_short_lag_agrees_with_the_whole_run(room, filtered):
    """The fixed-lag result ends where the whole one does."""
    measurements, result = filtered[0]
    epochs = 80
    part = replace(measurements, epochs=measurements.epochs[:epochs])
    cut = {
        name: getattr(result, name)[:epochs]
        for name in ("epoch", "time_s", "agent_mean", "agent_covariance", "rotation_std_rad", "anchor_valid")
        + ("anchor_mean_m", "anchor_covariance_m2", "wall_valid", "wall_mean_m", "wall_covariance_m2")
        + ("hypotheses", "log_evidence")
    }
    whole = refine(part, replace(result, **cut))
    lagged = refine(part, replace(result, **cut), config=RefineConfig(lag=10))
    np.testing.assert_allclose(lagged.agent_mean[-1, :2], whole.agent_mean[-1, :2], atol=0.05)
    assert np.sqrt(np.mean(derotated_part(lagged, room, epochs) ** 2)) < 0.15


def derotated_part(result, room, epochs: int) -> np.ndarray:
    return derotated(result, replace(room, track=room.track[:epochs]))


def test_unknown_clock_biases_are_found(room, filtered):
    """Biases of metres, of which the filter's result says nothing, are voted for and then estimated."""
    measurements, result = filtered[1]
    biases = (4.0, -2.5)
    late = tuple(
        replace(
            epoch,
            paths=tuple(
                replace(paths, delay_s=np.maximum(paths.delay_s + bias / SPEED_OF_LIGHT_M_S, 1e-9))
                for paths, bias in zip(epoch.paths, biases, strict=True)
            ),
        )
        for epoch in measurements.epochs
    )
    model = config_for(measurements).but(clock_bias_std_m=3.0)
    smoothed = refine(replace(measurements, epochs=late), result, model)
    plain = refine(measurements, result)
    assert np.sqrt(np.mean(derotated(smoothed, room) ** 2)) < 1.5 * np.sqrt(
        np.mean(derotated(plain, room) ** 2)
    )


def test_a_flood_is_passed_over(room, filtered):
    """Ten thousand paths of an anchor in an epoch are worth as much as none, in the filter and here."""
    measurements, _ = filtered[0]
    other = measurements.epochs[40].paths[1]
    length = np.random.default_rng(3).uniform(1.0, 180.0, 10_000)
    flood = AnchorPaths(length / SPEED_OF_LIGHT_M_S, np.full(length.size, 0.1 / SPEED_OF_LIGHT_M_S))
    smoothed = []
    for paths in (AnchorPaths.none(), flood):
        epochs = list(measurements.epochs[:80])
        epochs[40] = replace(epochs[40], paths=(paths, other))
        part = replace(measurements, epochs=tuple(epochs))
        smoothed.append(refine(part, run_slam(part)))
    np.testing.assert_array_equal(smoothed[1].agent_mean, smoothed[0].agent_mean)


@pytest.mark.parametrize("asked", [[True] * 6, [True, False, True, False, True, True]])
def test_visibility_is_the_posterior_of_all_histories(asked):
    """Forward-backward against the sum over every sequence of visible and invisible."""
    model = Visibility(appear_probability=0.2, vanish_probability=0.1)
    ratio = np.where(asked, [0.05, 3.0, 8.0, 0.05, 2.0, 0.4], 1.0)
    usable = np.array([True, True, True, True, False, True])
    move = np.array([[0.8, 0.2], [0.1, 0.9]])  # from (invisible, visible)
    weights = np.zeros((len(ratio), 2))
    for history in product((0, 1), repeat=len(ratio)):
        if any(seen and not can for seen, can in zip(history, usable, strict=True)):
            continue
        weight = 0.5
        for t, seen in enumerate(history):
            weight *= ratio[t] if seen else 1.0
            if t:
                # where it is impossible, what would have been visible is invisible
                chance = move[history[t - 1], seen] if asked[t] else float(history[t - 1] == seen)
                weight *= chance if usable[t] else 1.0
        weights[np.arange(len(ratio)), history] += weight
    expected = weights[:, 1] / weights.sum(axis=1)
    np.testing.assert_allclose(
        visibility(ratio, usable, model, np.array(asked)), expected, rtol=1e-12, atol=1e-15
    )


def test_results_that_do_not_fit_are_refused(filtered):
    """Another number of epochs; no wall that was sensed; settings out of range."""
    measurements, result = filtered[0]
    with pytest.raises(InputError, match="expected 10 epochs, got 236"):
        refine(replace(measurements, epochs=measurements.epochs[:10]), result)
    with pytest.raises(InputError, match="sensed at the start"):
        refine(measurements, replace(result, wall_mean_m=result.wall_mean_m + 100.0))
    for change in ({"rounds": 0}, {"first_spread_m": 0.0}, {"least_probability": 1.0}):
        with pytest.raises(ConfigurationError, match=next(iter(change))):
            RefineConfig(**change)


def test_anchors_far_above_are_found(filtered):
    """Anchors six metres above, of which the prior knows nothing, are voted for and then estimated."""
    measurements, result = filtered[0]

    def raised(paths):
        return replace(paths, delay_s=np.sqrt(paths.range_m**2 + 36.0) / SPEED_OF_LIGHT_M_S)

    epochs = tuple(replace(epoch, paths=tuple(map(raised, epoch.paths))) for epoch in measurements.epochs)
    model = config_for(measurements).but(height2_mean_m2=1.0, height2_std_m2=1.0)
    joint = refine(replace(measurements, epochs=epochs), result, model).joint
    np.testing.assert_allclose(joint.anchor_height2_m2, 36.0, atol=1.0)
    assert len(joint.path_epoch) > 0.9 * len(refine(measurements, result).joint.path_epoch)
