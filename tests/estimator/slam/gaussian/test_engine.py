"""The Gaussian engine on simulated runs through the paper's room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.errors import ConfigurationError, FileFormatError, InputError
from estimator.geometry import rotate
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.slam import GaussianConfig, load_state, run_slam, save_state, start, step
from estimator.slam.run import config_for


def derotated(track, truth):
    """Position errors (T,) after the best rotation about the origin."""
    cross = np.sum(track[:, 0] * truth[:, 1] - track[:, 1] * truth[:, 0])
    return np.linalg.norm(rotate(track, float(np.arctan2(cross, np.sum(track * truth)))) - truth, axis=1)


@pytest.fixture(scope="module")
def runs(room):
    """Eight whole runs with everything unknown."""
    return [run_slam(room.measure(seed)) for seed in range(40, 48)]


def test_everything_is_found_from_nothing(room, runs):
    """Track, anchors and all five reflecting walls; no run lost, no wall that is not there."""
    truth = room.track - room.track[0]
    for result in runs:
        assert derotated(result.agent_mean[:, :2], truth).max() < 1.0
        assert np.all(result.anchor_valid[-1])
        errors = np.linalg.norm(result.anchor_mean_m[-1] - (room.anchors - room.track[0]), axis=1)
        assert errors.max() < 2.0
        found = result.wall_mean_m[-1][result.wall_valid[-1]]
        distance = np.linalg.norm(found[:, None] - room.vrps[None], axis=-1)
        assert len(found) == 5
        assert sorted(np.argmin(distance, axis=1)) == [0, 1, 2, 3, 4]
        assert distance.min(axis=1).max() < 5.0


def test_covariances_are_honest(room, runs):
    """NEES per dimension, averaged over runs at the end, lies in the band of its spread."""
    truth = room.track - room.track[0]
    last = []
    for result in runs:
        error = result.agent_mean[-1, :2] - truth[-1]
        last.append(error @ np.linalg.solve(result.agent_covariance[-1, :2, :2], error) / 2.0)
    # chi-square with 16 degrees of freedom over 16: mean 1, standard deviation 0.35
    assert 0.25 < np.mean(last) < 2.4


def test_rotation_stays_as_uncertain_as_the_walls_left_it(runs):
    """Two hundred epochs of delays do not make the filter believe it knows the rotation.

    The four walls together give 7.5 mrad; a filter that lets passive delays inform
    the rotation ends far below.
    """
    for result in runs:
        assert 6.5e-3 < result.rotation_std_rad[-1] < 9.5e-3


def test_turning_the_frame_turns_the_result(room):
    """Walls given in a rotated frame give the same run, rotated, with equal evidence."""
    measured = room.measure(50, epochs=40)
    angle = 1.1
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    walls = tuple(GaussianVrp(turn @ w.mean_m, turn @ w.covariance_m2 @ turn.T) for w in measured.walls)
    plain, turned = run_slam(measured), run_slam(replace(measured, walls=walls))
    assert np.allclose(turned.agent_mean[:, :2], rotate(plain.agent_mean[:, :2], angle), atol=1e-5)
    assert np.allclose(turned.log_evidence, plain.log_evidence, atol=1e-5)


def test_a_saved_state_goes_on_bit_for_bit(room):
    """Saved and loaded after every few epochs, a run ends with the same bytes."""
    measured = room.measure(51, epochs=100)
    config = config_for(measured)
    straight = broken = start(measured.walls, measured.anchors, measured.carrier_hz, config)
    for epoch in measured.epochs:
        straight, broken = step(straight, epoch, config), step(broken, epoch, config)
        if epoch.index % 7 == 0:
            broken = load_state(save_state(broken))
    assert save_state(straight) == save_state(broken)


def test_a_step_leaves_its_state_alone(room):
    """States are values: stepping one does not change it."""
    measured = room.measure(52, epochs=30)
    config = config_for(measured)
    state = start(measured.walls, measured.anchors, measured.carrier_hz, config)
    for epoch in measured.epochs:
        before = save_state(state)
        after = step(state, epoch, config)
        assert save_state(state) == before
        state = after


def test_known_anchors_need_no_echoes(room):
    """`mva`: with the anchors' places and no sensed wall, all walls due and the track are found."""
    errors, scores = [], []
    for seed in (2, 3, 4):
        measured = room.measure(seed, know_anchors=True)
        result = run_slam(measured, "mva", "gaussian", seed)
        truth = room.track - room.track[0]
        errors.append(np.linalg.norm(result.agent_mean[:, :2] - truth, axis=1))
        error = result.agent_mean[1:, :2] - truth[1:]
        spread = result.agent_covariance[1:, :2, :2]
        scores.append(np.einsum("ti,tij,tj->t", error, np.linalg.inv(spread), error) / 2.0)
        final = result.wall_mean_m[-1][result.wall_valid[-1]]
        away = np.linalg.norm(final[:, None] - room.vrps[None, :5], axis=-1)
        assert np.all(away.min(axis=0) < 1.0)
        assert np.all(away.min(axis=1) < 1.0)
    assert np.mean(np.array(errors)[:, 30:]) < 0.15  # the bound is 0.085 at the end
    assert 0.3 < np.mean(scores) < 2.5
    lacking = room.measure(2, epochs=2)
    with pytest.raises(InputError, match="method mva: expected known anchors, the measurements have none"):
        run_slam(lacking, "mva", "gaussian")


def test_what_is_known_is_used_together(room, caplog):
    """`hybrid` takes known anchors with the walls sensed; `mva` leaves the walls aside, and says so."""
    measured = room.measure(2, epochs=40, know_anchors=True)
    blind = replace(measured, known_anchors_m=None)
    told, untold = run_slam(measured, "hybrid"), run_slam(blind, "hybrid")
    np.testing.assert_allclose(told.anchor_mean_m[0], measured.known_anchors_m, atol=1e-9)
    assert told.wall_valid[0].sum() == len(measured.walls)
    spread = [np.trace(result.agent_covariance[-1, :2, :2]) for result in (told, untold)]
    assert spread[0] < 0.5 * spread[1]
    error = told.agent_mean[-1, :2] - (room.track[39] - room.track[0])
    assert np.linalg.norm(error) < 4.0 * np.sqrt(spread[0]) + 0.05
    with caplog.at_level("INFO", logger="hapslam"):
        run_slam(room.measure(2, epochs=2, know_anchors=True), "mva")
    assert "method mva takes no walls: " in caplog.text


def test_echoes_alone(room):
    """`active`: paths change nothing; without sweeps the agent is soon anywhere, with them it is followed."""
    measured = room.measure(5, epochs=40, sweep_every=1)
    truth = room.track[:40] - room.track[0]
    followed = run_slam(measured, "active", "gaussian")
    assert not followed.anchor_valid.any()
    assert np.linalg.norm(followed.agent_mean[:, :2] - truth, axis=1).max() < 3.0
    deaf = replace(
        measured,
        epochs=tuple(replace(epoch, paths=(AnchorPaths.none(),) * 2) for epoch in measured.epochs),
    )
    np.testing.assert_array_equal(run_slam(deaf, "active", "gaussian").agent_mean, followed.agent_mean)
    blind = replace(measured, epochs=tuple(replace(epoch, sweep=()) for epoch in measured.epochs))
    lost = run_slam(blind, "active", "gaussian")
    assert np.all(np.diff(lost.agent_covariance[:, 0, 0]) > 0.0)
    assert lost.agent_covariance[-1, 0, 0] > 100.0 * followed.agent_covariance[-1, 0, 0]


def test_an_anchor_that_is_heard_late_is_located_late(room):
    """An anchor silent for thirty epochs starts from a window and ends as good as the other."""
    measured = room.measure(53, epochs=150)
    silent = AnchorPaths.none()
    epochs = tuple(
        replace(epoch, paths=(silent, epoch.paths[1])) if epoch.index < 30 else epoch
        for epoch in measured.epochs
    )
    result = run_slam(replace(measured, epochs=epochs))
    assert not result.anchor_valid[29, 0]
    assert np.all(result.anchor_valid[60:, 0])
    error = np.linalg.norm(result.anchor_mean_m[-1] - (room.anchors - room.track[0]), axis=1)
    assert error.max() < 2.0


def test_epochs_may_be_skipped_but_not_repeated(room):
    """A gap is bridged by the motion model; a repeated epoch is an error that says so."""
    measured = room.measure(54, epochs=60)
    kept = tuple(epoch for epoch in measured.epochs if epoch.index % 5)
    result = run_slam(replace(measured, epochs=kept))
    truth = (room.track - room.track[0])[result.epoch]
    assert derotated(result.agent_mean[:, :2], truth).max() < 1.0
    config = config_for(measured)
    state = start(measured.walls, measured.anchors, measured.carrier_hz, config)
    state = step(state, measured.epochs[1], config)
    with pytest.raises(InputError, match="epoch 1 .*expected one later than epoch 1"):
        step(state, measured.epochs[1], config)
    with pytest.raises(InputError, match="expected paths of 2 anchors, got 1"):
        step(state, Epoch(2, 2.0, measured.epochs[2].paths[:1]), config)


def test_damaged_states_are_refused(room):
    """Truncated or foreign bytes give a clear error."""
    measured = room.measure(55, epochs=1)
    data = save_state(start(measured.walls, measured.anchors, 28e9, GaussianConfig()))
    for damaged in (b"", data[: len(data) // 2], b"PK not a state", data[:-10]):
        with pytest.raises(FileFormatError, match="expected hapslam-gaussian-state/12"):
            load_state(damaged)


def test_unknown_methods_and_engines_are_named(room):
    """The error lists what there is."""
    measured = room.measure(56, epochs=1)
    with pytest.raises(ConfigurationError, match="method: expected one of hybrid.* got 'magic'"):
        run_slam(measured, method="magic")
    with pytest.raises(ConfigurationError, match="engine: expected one of gaussian.* got 'steam'"):
        run_slam(measured, engine="steam")
    with pytest.raises(ConfigurationError, match="measurement_model: expected names of settings"):
        run_slam(replace(measured, settings={"measurement_model": {"colour": 1}}))


@pytest.mark.parametrize(
    ("field", "value"),
    [("range_std_m", 0.0), ("clutter_mean", -1.0), ("region_m", np.nan), ("detection_probability", 1.0)],
)
def test_configuration_is_checked(field, value):
    """Values out of range name the field."""
    with pytest.raises(ConfigurationError, match=field):
        GaussianConfig.of(**{field: value})
