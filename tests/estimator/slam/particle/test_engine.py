"""The particle engine and its methods on simulated runs, against exact filters where there are any."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import ConfigurationError, FileFormatError, InputError
from estimator.evaluation.metrics import best_rotation, derotated, match
from estimator.measurements import AnchorPaths, Epoch, MeasurementSet
from estimator.slam import GaussianConfig, run_slam
from estimator.slam.methods import METHODS, PAIRS
from estimator.slam.models.motion import process_noise, transition
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.protocol import Prior, epoch_rng
from estimator.slam.run import config_for, engine_for
from estimator.waveform import SPEED_OF_LIGHT_M_S


def run(measured, method="hybrid", particles=3000, seed=0, **changes):
    """A run with few particles."""
    config = config_for(measured, engine="particle").but(particles=particles, **changes)
    return run_slam(measured, method, "particle", seed, config)


def measure(room, seed, epochs=None, **model):
    """A simulated run that says where the anchors are."""
    return replace(room.measure(seed, epochs, **model), known_anchors_m=room.anchors - room.track[0])


def ranging(places, track, rng, step_s=1.0):
    """Epochs of lines of sight alone, every one heard, without clutter."""
    std = np.array([0.1 / SPEED_OF_LIGHT_M_S])
    return tuple(
        Epoch(
            t,
            t * step_s,
            tuple(
                AnchorPaths(
                    (np.linalg.norm(p - u, keepdims=True) + rng.normal(scale=0.1)) / SPEED_OF_LIGHT_M_S, std
                )
                for p in places
            ),
        )
        for t, u in enumerate(track)
    )


def test_tracking_between_known_anchors_is_a_kalman_filter():
    """With anchors far away ranges are linear: means and covariances are the Kalman filter's."""
    rng = np.random.default_rng(11)
    places = np.array([[150.0, 0.0], [0.0, 160.0]])
    track = np.column_stack([0.3 * np.arange(15), 0.1 * np.arange(15)])
    epochs = ranging(places, track, rng)
    measured = MeasurementSet(("a", "b"), (), epochs, 28e9, known_anchors_m=places)
    count = 20_000
    config = ParticleConfig.of(
        particles=count, range_std_m=0.1, clutter_mean=0.0, acceleration_variance=0.01, start_std_m=0.2,
        velocity_std_m_s=0.3, start_visibility=1.0, vanish_probability=0.0,
    )  # fmt: skip
    result = run_slam(measured, "va", "particle", 3, config)
    mean, covariance = np.zeros(4), np.diag([0.04, 0.04, 0.09, 0.09])
    for t, epoch in enumerate(epochs):
        if t:
            move = transition(1.0)
            mean, covariance = move @ mean, move @ covariance @ move.T + process_noise(1.0, 0.01)
        for place, paths in zip(places, epoch.paths, strict=True):
            unit = np.concatenate([(mean[:2] - place) / np.linalg.norm(mean[:2] - place), [0.0, 0.0]])
            variance = unit @ covariance @ unit + 0.01
            gain = covariance @ unit / variance
            mean = mean + gain * (paths.range_m[0] - np.linalg.norm(mean[:2] - place))
            covariance = covariance - np.outer(gain, unit @ covariance)
        # errors of a few epochs add up before the filter forgets them: five of them
        standard = np.sqrt(np.diag(covariance) * 5.0 / count)
        assert np.all(np.abs(result.agent_mean[t] - mean) < 5.0 * standard + 2e-3)
        scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
        assert np.all(np.abs(result.agent_covariance[t] - covariance) < 5.0 * np.sqrt(10.0 / count) * scale)


def test_with_sharp_walls_the_joint_filter_is_met(room):
    """Where walls are known well, what independent marginals forget is little: the engines agree.

    Anchors after the first epoch agree in mean and covariance; the track, at the typical
    epoch (at a few, where paths cross, they resolve the labels differently), within half
    of the joint filter's standard deviation.
    """
    measured = room.measure(1, 40, clutter_mean=0.0, detection_probability=0.99)
    sharp = tuple(
        replace(wall, mean_m=true, covariance_m2=1e-3 * np.eye(2))
        for wall, true in zip(measured.walls, room.vrps[:4], strict=True)
    )
    measured = replace(measured, walls=sharp)
    joint, particle = run_slam(measured), run(measured, particles=4000)
    assert particle.anchor_mean_m[0] == pytest.approx(joint.anchor_mean_m[0], abs=0.05)
    traces = [np.trace(r.anchor_covariance_m2[0], axis1=1, axis2=2) for r in (joint, particle)]
    assert traces[1] == pytest.approx(traces[0], rel=0.25)
    gap = np.linalg.norm((particle.agent_mean - joint.agent_mean)[1:, :2], axis=1)
    std = np.sqrt(np.trace(joint.agent_covariance[1:, :2, :2], axis1=1, axis2=2))
    assert np.median(gap) < 0.5 * np.median(std)


def test_hybrid_maps_a_room_from_nothing(room):
    """A whole run: never lost, all five walls, anchors within two metres."""
    result = run(room.measure(42), particles=4000)
    truth = room.track - room.track[0]
    track = result.agent_mean[:, :2]
    assert np.linalg.norm(derotated(track, best_rotation(track, truth)) - truth, axis=1).max() < 1.0
    assert np.linalg.norm(result.anchor_mean_m[-1] - (room.anchors - room.track[0]), axis=1).max() < 2.0
    found = result.wall_mean_m[-1][result.wall_valid[-1]]
    assert {j for _, j in match(found, room.vrps, 5.0)} >= {0, 1, 2, 3, 4}


def test_known_anchors_make_better_maps(room):
    """``mva`` finds the walls it was not told of, and its track does not turn as hybrid's does."""
    measured = measure(room, 42, 60)
    truth = room.track[:60] - room.track[0]
    result = run(measured, "mva")
    error = np.linalg.norm(result.agent_mean[:, :2] - truth, axis=1)
    assert error.max() < 0.6
    found = result.wall_mean_m[-1][result.wall_valid[-1]]
    assert len(match(found, room.vrps[:4], 2.0)) == 4
    assert result.wall_valid[0].sum() == 0


def test_a_feature_on_a_circle_is_not_found_yet(room):
    """It exists and is nowhere yet: a candidate, and a wall only where that is asked for, as published."""
    measured = measure(room, 42, 8)
    config = config_for(measured, engine="particle").but(particles=3000)
    engine = engine_for("mva", "particle", config)
    asked = replace(engine, config=config.but(found_std_m=1e6))
    state, circles = engine.start(Prior.of(measured), epoch_rng(0, -1)), 0
    for epoch in measured.epochs:
        state = engine.step(state, epoch, epoch_rng(0, epoch.index))
        found, every = engine.estimate(state), asked.estimate(state)
        spread = np.sqrt(0.5 * np.trace(every.wall_covariance_m2, axis1=1, axis2=2))
        assert set(found.wall_id.tolist()) == set(every.wall_id[spread <= 5.0].tolist())
        waiting = {int(each.wall_id[0]) for each in found.candidates}
        assert set(every.wall_id[spread > 5.0].tolist()) <= waiting
        circles += int(np.sum(spread > 5.0))
    assert circles >= 1


def test_virtual_anchors_are_mapped_for_each_anchor(room):
    """``va`` follows the agent by features of each anchor alone."""
    result = run(measure(room, 41, 60), "va")
    truth = room.track[:60] - room.track[0]
    assert np.linalg.norm(result.agent_mean[:, :2] - truth, axis=1).max() < 0.7
    assert result.wall_valid[-1].sum() >= 4


def test_passive_sensing_knows_distances_but_not_directions(room):
    """The map turns as the bearing that was drawn, with distances from the start and angles in it right.

    The median of three runs: one may follow a wrong mode of a map that is still free.
    """
    measured = room.measure(1, 40, clutter_mean=0.0, detection_probability=0.99)
    truth = room.track[:40] - room.track[0]
    bearings, distance_error, angle_error = [], [], []

    def angle(a, b):
        return np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))

    for seed in range(3):
        result = run(measured, "passive", seed=seed)
        distance = np.linalg.norm(result.agent_mean[10:, :2], axis=1)
        distance_error.append(np.abs(distance - np.linalg.norm(truth[10:], axis=1)).max())
        anchor, walk = result.anchor_mean_m[-1, 0], result.agent_mean[-1, :2]
        angle_error.append(abs(angle(anchor, walk) - angle(room.anchors[0] - room.track[0], truth[-1])))
        bearings.append(np.arctan2(anchor[1], anchor[0]))
    assert np.median(distance_error) < 3.0  # of 20 m walked
    assert np.median(angle_error) < 0.6  # of anything up to pi
    assert np.ptp(bearings) > 0.5


def test_active_sensing_alone_follows_the_motion_model(room):
    """Without paths the agent's covariance is the prior's, carried on; the walls stay."""
    measured = room.measure(2, 10)
    result = run(measured, "active", particles=20_000)
    covariance = np.diag([0.0, 0.0, 1.0, 1.0])
    for _ in range(9):
        covariance = transition(1.0) @ covariance @ transition(1.0).T + process_noise(1.0, 0.0278)
    assert result.agent_covariance[-1] == pytest.approx(covariance, rel=0.05, abs=0.05 * covariance[0, 0])
    assert np.all(np.abs(result.agent_mean[-1, :2]) < 5.0 * np.sqrt(covariance[0, 0] / 20_000))
    assert result.wall_mean_m[-1] == pytest.approx(np.array([w.mean_m for w in measured.walls]), abs=0.1)
    assert not result.anchor_valid.any()


@pytest.mark.parametrize("method", [name for name, engine in PAIRS if engine == "particle"])
def test_a_run_may_be_broken_off_anywhere(room, method):
    """Saved and loaded after every epoch, a run ends with the same bytes; stepping changes no state."""
    measured = measure(room, 5, 12)
    config = config_for(measured, engine="particle").but(particles=300)
    engine = engine_for(method, "particle", config)
    straight = broken = engine.start(Prior.of(measured), epoch_rng(9, -1))
    for epoch in measured.epochs:
        before = engine.save(straight)
        after = engine.step(straight, epoch, epoch_rng(9, epoch.index))
        assert engine.save(straight) == before
        straight, broken = after, engine.step(engine.load(before), epoch, epoch_rng(9, epoch.index))
        assert engine.save(straight) == engine.save(broken)


def test_the_seed_is_the_only_randomness(room):
    """Equal seeds give equal runs, other seeds other runs."""
    measured = room.measure(6, 8)
    first, again, other = (run(measured, particles=500, seed=s) for s in (1, 1, 2))
    assert np.array_equal(first.agent_mean, again.agent_mean)
    assert not np.array_equal(first.agent_mean, other.agent_mean)


def test_an_anchor_that_is_heard_late_is_located_late(room):
    """An anchor silent for ten epochs is found from a window of later ones."""
    measured = room.measure(7, 40)
    silent = AnchorPaths.none()
    epochs = tuple(
        replace(epoch, paths=(silent, epoch.paths[1])) if epoch.index < 10 else epoch
        for epoch in measured.epochs
    )
    result = run(replace(measured, epochs=epochs))
    assert not result.anchor_valid[9, 0]
    assert result.anchor_valid[30:, 0].all()
    assert np.linalg.norm(result.anchor_mean_m[-1, 0] - (room.anchors[0] - room.track[0])) < 3.0


def test_unknown_pairs_say_what_there_is(room):
    """Every pair of the table runs; others, and another engine's configuration, are refused by name."""
    measured = measure(room, 8, 1)
    for method, engine in PAIRS:
        assert engine_for(method, engine, config_for(measured, engine=engine)).name == engine
    missing = [m for m in METHODS if (m, "gaussian") not in PAIRS]
    for method in missing:
        with pytest.raises(ConfigurationError, match=f"method: expected one of hybrid.* got '{method}'"):
            engine_for(method, "gaussian", GaussianConfig())
    with pytest.raises(ConfigurationError, match="expected a ParticleConfig for engine particle"):
        engine_for("va", "particle", GaussianConfig())
    with pytest.raises(ConfigurationError, match="engine: expected one of gaussian, particle, got 'steam'"):
        config_for(measured, engine="steam")


def test_what_a_method_needs_is_asked_for(room):
    """Missing anchors or walls, a repeated epoch and another method's state give clear errors."""
    measured = room.measure(9, 2)
    for method in ("va", "mva"):
        with pytest.raises(InputError, match=f"{method} SLAM: expected measurements that know where"):
            run(measured, method)
    for method in ("hybrid", "active"):
        with pytest.raises(InputError, match=f"{method} SLAM: expected at least one wall"):
            run(replace(measured, walls=()), method)
    config = config_for(measured, engine="particle").but(particles=100)
    engine, rng = engine_for("hybrid", "particle", config), np.random.default_rng(0)
    state = engine.step(engine.start(Prior.of(measured), rng), measured.epochs[1], rng)
    with pytest.raises(InputError, match="epoch 1 .*expected one later than epoch 1"):
        engine.step(state, measured.epochs[1], rng)
    with pytest.raises(InputError, match="expected paths of 2 anchors, got 1"):
        engine.step(state, Epoch(2, 2.0, measured.epochs[1].paths[:1]), rng)
    with pytest.raises(InputError, match="expected one of method active, got hybrid"):
        engine_for("active", "particle", config).load(engine.save(state))
    data = engine.save(state)
    for damaged in (b"", data[: len(data) // 2], b"PK not a state"):
        with pytest.raises(FileFormatError, match="expected hapslam-particle-state/2"):
            engine.load(damaged)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("particles", 0),
        ("particles", 10.5),
        ("survival_probability", 1.1),
        ("region_m", np.nan),
        ("pairings", -1),
    ],
)
def test_configuration_is_checked(field, value):
    """Values out of range name the field."""
    with pytest.raises(ConfigurationError, match=rf"\.{field}: expected"):
        ParticleConfig.of(**{field: value})


def test_the_published_inference_is_one_call_away():
    """The paper's constants to the letter, models untouched."""
    config = ParticleConfig.of(range_std_m=0.1).published()
    assert (config.noise.range_std_m, config.inference.pairings, config.motion.feature_std_m**2) == (
        0.1,
        1,
        pytest.approx(1e-8),
    )
    assert (
        config.visibility.start_visibility,
        config.visibility.vanish_probability,
        config.inference.worse_ratio,
    ) == (1.0, 0.0, 1.0)


def test_the_seminar_room_is_tracked():
    """Public range sets of a seminar room: ``va`` with few particles stays within a quarter of a metre."""
    folder = Path(os.environ.get("HAPSLAM_SEMROOM", "semroom-not-given"))
    if not (folder / "scenario.npz").exists():
        pytest.skip("HAPSLAM_SEMROOM names no folder with scenario.npz and measurements_seed*.npz")
    scenario, sets = np.load(folder / "scenario.npz"), np.load(folder / "measurements_seed4.npz")
    track = scenario["trajectory"][:, :150].T
    places = np.array([scenario[f"va_positions_{k}"][:, 0] for k in (0, 1)]) - track[0]
    ranges, offsets = np.maximum(sets["range_m"], 1e-3) / SPEED_OF_LIGHT_M_S, sets["offsets"]
    epochs = []
    for t in range(len(track)):
        heard = [ranges[offsets[2 * t + k] : offsets[2 * t + k + 1]] for k in (0, 1)]
        paths = tuple(AnchorPaths(r, np.full(r.shape, 0.1 / SPEED_OF_LIGHT_M_S)) for r in heard)
        epochs.append(Epoch(t, float(t), paths))
    measured = MeasurementSet(("a", "b"), (), tuple(epochs), 6e9, known_anchors_m=places)
    config = ParticleConfig.of(
        particles=5000, range_std_m=0.1, region_m=30.0, acceleration_variance=1e-4, velocity_std_m_s=0.03,
        start_std_m=0.25,
    )  # fmt: skip
    result = run_slam(measured, "va", "particle", 0, config)
    error = np.linalg.norm(result.agent_mean[:, :2] - (track - track[0]), axis=1)
    assert error.mean() < 0.15
    assert error.max() < 0.5
