"""Posterior Cramer-Rao bounds of the paper's room, and of what they are made."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import mirror_in_wall
from estimator.sensing.linefit import fit_lines
from estimator.sensing.ranges import EchoLaw, variance_published
from estimator.slam.bounds.posterior import expected_distance, posterior_bounds
from estimator.slam.bounds.scenario import Scenario, Sensing
from estimator.slam.models.sweeps import predict_flashes
from estimator.waveform import OfdmGrid

SENSED = {0: 0.08, 1: 0.7, 2: 4.0, 3: 0.2}
PAPER = {"sensed": SENSED, "detection_probability": 0.95}


@pytest.fixture(scope="module")
def scenario(room):
    """The paper's five reflecting walls, anchors P0 and the smoothed track."""
    from raytrace.plan.files import load_floorplan  # plain pydantic, no ray tracer

    track = load_floorplan("l-room").track()[:, :2]
    return Scenario(room.walls[:5, 0], room.walls[:5, 1], room.anchors, track)


@pytest.mark.parametrize(
    ("change", "rmse", "mae", "rotation_mrad", "ospa"),
    [
        ({}, 0.463, 0.38, 7.46, 0.43),
        ({"anchors_known": True}, 0.098, 0.085, 0.0, 0.057),
        ({"sweep_every": 10}, 0.145, 0.128, 1.35, 0.13),
        ({"azimuth_std_rad": np.deg2rad(1.0)}, 0.120, 0.107, 0.39, 0.10),
        ({"clock_bias": "common"}, 0.463, 0.38, 7.46, 0.43),
        ({"clock_bias": "each"}, 0.463, 0.38, 7.46, 0.43),
    ],
    ids=["hybrid", "anchors known", "sweeps", "angles", "common bias", "each its bias"],
)
def test_limits_of_the_papers_scenario(scenario, change, rmse, mae, rotation_mrad, ospa):
    """The table of limits at t = 236, to its last digit."""
    found = posterior_bounds(scenario, Sensing(**PAPER, **change))
    assert found.position_rmse_m[-1] == pytest.approx(rmse, abs=0.001)
    assert found.position_mae_m[-1] == pytest.approx(mae, abs=0.002)
    assert 1e3 * found.rotation_std_rad[-1] == pytest.approx(rotation_mrad, abs=0.006)
    assert found.vrp_ospa_m()[-1] == pytest.approx(ospa, abs=0.006)
    if not change:
        assert found.derotated_rmse_m[-1] == pytest.approx(0.12, abs=0.002)


def test_limit_with_walls_from_many_beams(scenario):
    """64 beams at the start, maximum-likelihood lines, echoes that fall as d^-2: 0.187 m and 2.58 mrad."""
    azimuth = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    normals = scenario.vrps_m[:4] / np.linalg.norm(scenario.vrps_m[:4], axis=1, keepdims=True)
    cosine = towards @ normals.T
    with np.errstate(divide="ignore"):
        ranges = np.where(cosine > 0.0, 0.5 * np.linalg.norm(scenario.vrps_m[:4], axis=1) / cosine, np.inf)
    ranges[10.0 + ranges[:, 1] * towards[:, 0] > 50.0, 1] = np.inf  # the wall y = 40 ends there
    met = np.argmin(ranges, axis=1)
    distance, incidence = ranges.min(axis=1), np.arccos(cosine[np.arange(64), met])
    law = EchoLaw(exponent=2.0)
    std = np.sqrt(variance_published(OfdmGrid(28e9, 120e3, 200), law.at(distance, incidence)))
    sensed = {
        wall: fit_lines(distance[met == wall], std[met == wall], azimuth[met == wall]).covariance_m2
        for wall in range(4)
    }
    found = posterior_bounds(scenario, Sensing(sensed=sensed, detection_probability=0.95))
    assert found.position_rmse_m[-1] == pytest.approx(0.187, abs=0.001)
    assert found.position_mae_m[-1] == pytest.approx(0.161, abs=0.0015)
    assert 1e3 * found.rotation_std_rad[-1] == pytest.approx(2.58, abs=0.01)


def test_two_routes_to_the_last_epoch(scenario):
    """The covariance recursion and the eliminated information of the whole run agree where they must."""
    for change in (
        {},
        {"azimuth_std_rad": 0.02, "heading_held": False},
        {"clock_bias": "each", "sweep_every": 50},
        {"clock_bias": "free"},
    ):
        sensing = Sensing(**PAPER, **change)
        forward, batch = posterior_bounds(scenario, sensing), posterior_bounds(scenario, sensing, "batch")
        np.testing.assert_allclose(
            batch.position_covariance_m2[-1], forward.position_covariance_m2[-1], rtol=0.01, atol=1e-5
        )
        np.testing.assert_allclose(
            batch.wall_covariance_m2[-1], forward.wall_covariance_m2[-1], rtol=0.01, atol=1e-4
        )
        # later measurements can only help
        assert np.all(batch.position_rmse_m <= forward.position_rmse_m + 2e-3)


def test_rotation_is_known_from_the_walls_sensed_alone(scenario):
    """Path lengths never tell the rotation: at every epoch it is what the first sweep knew."""
    radius2 = np.sum(scenario.vrps_m[:4] ** 2, axis=1)
    expected = 1.0 / np.sqrt(np.sum(radius2 / np.array(list(SENSED.values()))))
    found = posterior_bounds(scenario, Sensing(sensed=SENSED))
    np.testing.assert_allclose(found.rotation_std_rad, expected, rtol=1e-3)
    lost = posterior_bounds(scenario, Sensing())
    assert np.all(lost.rotation_std_rad > 0.5)
    assert lost.derotated_rmse_m[-1] < 1.0
    held = posterior_bounds(scenario, Sensing(sensed=SENSED, sweep_every=10, heading_held=False))
    np.testing.assert_allclose(held.rotation_std_rad, expected, rtol=1e-3)


def test_double_bounces_and_known_walls_inform(scenario):
    """More that is measured or known, less error; heights unknown, a little more."""
    hybrid = posterior_bounds(scenario, Sensing(sensed=SENSED)).derotated_rmse_m[-1]
    assert posterior_bounds(scenario, Sensing(sensed=SENSED, order=2)).derotated_rmse_m[-1] < 0.8 * hybrid
    assert posterior_bounds(scenario, Sensing(walls_known=True)).position_rmse_m[-1] < hybrid
    uneven = posterior_bounds(scenario, Sensing(sensed=SENSED, height2_std_m2=1.0))
    assert uneven.derotated_rmse_m[-1] >= hybrid


def test_sweep_measures_the_agents_image(scenario):
    """Value and derivatives of a repeated sweep's measurement against mirror geometry and differences."""
    layout, state = scenario.layout, scenario.states[77]
    for wall in range(layout.slots):
        image, jacobian = (both[wall] for both in predict_flashes(state, layout))
        place = scenario.track_m[77]
        mirrored = mirror_in_wall(place, scenario.start_m[wall], scenario.end_m[wall])
        np.testing.assert_allclose(image, mirrored - place, atol=1e-9)
        for column in (0, 1, *range(layout.wall(wall).start, layout.wall(wall).stop)):
            step = np.zeros(layout.size)
            step[column] = 1e-5
            ahead, behind = (
                predict_flashes(moved, layout)[0][wall] for moved in (state + step, state - step)
            )
            np.testing.assert_allclose(jacobian[:, column], (ahead - behind) / 2e-5, atol=1e-7)


def test_mean_distance_is_the_integral():
    """E min(|e|, c) of a Gaussian in the plane against numerical integration, and without cut-off."""
    covariance = np.array([[2.0, 0.6], [0.6, 0.5]])
    precision = np.linalg.inv(covariance)

    def integrand(r: float, a: float) -> float:
        e = r * np.array([np.cos(a), np.sin(a)])
        return min(r, 1.5) * r * np.exp(-0.5 * e @ precision @ e)

    total = sum(
        dblquad(integrand, 0.0, 2.0 * np.pi, *part, epsabs=1e-8)[0] for part in ((0.0, 1.5), (1.5, 12.0))
    )
    expected = total / (2.0 * np.pi * np.sqrt(np.linalg.det(covariance)))
    assert expected_distance(covariance, 1.5) == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(
        expected_distance([np.eye(2), np.diag([1.0, 0.0])]), np.sqrt([np.pi / 2, 2 / np.pi]), rtol=1e-4
    )
    assert expected_distance(1e12 * np.eye(2), 10.0) == pytest.approx(10.0, abs=1e-3)


def test_walls_count_once_they_reflect(scenario, room):
    """The map owes the fifth wall from when it is first heard, and never a wall heard in passing."""
    found = posterior_bounds(scenario, Sensing(sensed=SENSED))
    assert found.wall_counts[0].tolist() == [True, True, True, True, False]
    first = int(np.argmax(found.wall_counts[:, 4]))
    assert 50 < first < 90
    whole = Scenario(room.walls[:, 0], room.walls[:, 1], room.anchors, scenario.track_m)
    assert not posterior_bounds(whole, Sensing(sensed=SENSED)).wall_counts[-1, 5]


def test_bad_scenarios_and_settings_are_named(scenario):
    """Shapes, kinds and numbers out of range."""
    with pytest.raises(InputError, match="anchors_m"):
        Scenario(scenario.start_m, scenario.end_m, np.zeros((2, 3)), scenario.track_m)
    with pytest.raises(InputError, match="one end for every start"):
        Scenario(scenario.start_m, scenario.end_m[:2], scenario.anchors_m, scenario.track_m)
    with pytest.raises(InputError, match="step_s"):
        Scenario(scenario.start_m, scenario.end_m, scenario.anchors_m, scenario.track_m, 0.0)
    with pytest.raises(ConfigurationError, match="'recursive' or 'batch', got 'other'"):
        posterior_bounds(scenario, Sensing(), "other")
    with pytest.raises(InputError, match="cutoff"):
        expected_distance(np.eye(2), -1.0)
    for change in (
        {"range_std_m": 0.0},
        {"azimuth_std_rad": -1.0},
        {"detection_probability": 0.0},
        {"order": 3},
        {"clock_bias": "some"},
        {"sweep_every": -1},
        {"height2_std_m2": np.nan},
    ):
        with pytest.raises(ConfigurationError, match=next(iter(change))):
            Sensing(**change)
