"""Arrays, headings, Doppler shifts and clocks: against geometry and differences along the track."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import PathSet
from raytrace.radio.reception import doppler_hz, receive


@pytest.fixture(scope="module")
def plan() -> FloorPlan:
    return updated(load_floorplan("l-room"), {"agent.epochs": 40, "tracing.depth": 2})


def lone(paths: PathSet, epoch: int = 0) -> tuple[PathSet, int]:
    """The line of sight of one epoch alone, and its anchor."""
    flat = paths.flat()
    path = flat.select(np.flatnonzero((flat.epoch == epoch) & (flat.order == 0))[:1])
    return PathSet.build(path.select(np.array([0])), epoch + 1, paths.valid.shape[1]), int(path.anchor[0])


@pytest.mark.parametrize("heading_deg", [0.0, 40.0])
def test_array_phases_follow_the_arrival_angle(plan: FloorPlan, heading_deg: float) -> None:
    """With one path, antennas differ by the steering phase, and the heading turns it."""
    turned = updated(plan, {"radio.agent_array.elements": 4, "agent.heading_deg": heading_deg})
    one, anchor = lone(image_paths(turned))
    azimuth, elevation = one.arrival_azimuth_rad[0, anchor, 0], one.arrival_elevation_rad[0, anchor, 0]
    response = receive(turned, one, np.array([0]))[0, anchor, 0, 0]
    ratio = response[1:] / response[:-1]
    expected = np.exp(1j * np.pi * np.cos(elevation) * np.sin(azimuth - np.deg2rad(heading_deg)))
    np.testing.assert_allclose(ratio, np.full_like(ratio, expected), rtol=1e-9)


def test_heading_along_the_direction_of_travel(plan: FloorPlan) -> None:
    """Turning with the track, the heading is the direction of the next step, plus what the mount adds."""
    turning = updated(plan, {"agent.orientation": "travel", "agent.heading_deg": 10.0})
    track = turning.track()[:, :2]
    steps = np.diff(track, axis=0)
    ahead = np.arctan2(steps[:, 1], steps[:, 0]) + np.deg2rad(10.0)
    middle = 0.5 * (turning.headings_rad()[1:] + turning.headings_rad()[:-1])
    np.testing.assert_allclose(middle, ahead, atol=2e-3)
    assert turning.heading_rad == pytest.approx(ahead[0], abs=1e-6)
    assert np.ptp(plan.headings_rad()) == 0.0
    longer = updated(turning, {"agent.epochs": 200})
    np.testing.assert_array_equal(longer.headings_rad()[:40], turning.headings_rad())
    assert np.ptp(longer.headings_rad()) > 1.0  # the track turns into the other wing


def test_a_turning_array_sees_sources_turn_back(plan: FloorPlan) -> None:
    """Ahead is broadside to an array that looks ahead: its phases follow the heading of the epoch."""
    turning = updated(
        plan, {"agent.orientation": "travel", "radio.agent_array.elements": 2, "agent.epochs": 150}
    )
    paths = image_paths(turning, depth=0)
    response = receive(turning, paths, np.arange(150))
    seen = paths.valid[:, 0, 0]
    relative = paths.arrival_azimuth_rad[seen, 0, 0] - turning.headings_rad()[seen]
    expected = np.exp(1j * np.pi * np.cos(paths.arrival_elevation_rad[seen, 0, 0]) * np.sin(relative))
    ratio = response[seen, 0, 0, 0, 1, 0] / response[seen, 0, 0, 0, 0, 0]
    np.testing.assert_allclose(ratio, expected, rtol=1e-9)


def test_doppler_is_the_rate_of_path_length(plan: FloorPlan) -> None:
    """``f_D = v . k / lambda`` is minus the derivative of the length of the exact image path over lambda.

    The derivative is that of a central difference of 2 mm along the direction of travel.
    """
    fast = updated(plan, {"agent.speed_m_s": 20.0})
    track, velocity = fast.track(), fast.velocities_m_s()
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 20.0)
    paths = image_paths(fast)
    shift = doppler_hz(fast, paths, np.arange(40))
    step = 1e-3 * velocity / 20.0
    before, after = (image_paths(fast, track + sign * step) for sign in (-1, 1))
    lengths = []
    here = paths.flat()
    key = here.keys(2, len(fast.surface_names))
    for moved in (before, after):
        flat = moved.flat()
        there = dict(zip(flat.keys(2, len(fast.surface_names)).tolist(), flat.delay_s, strict=True))
        lengths.append(np.array([there.get(name, np.nan) for name in key.tolist()]) * SPEED_OF_LIGHT_M_S)
    rate = (lengths[1] - lengths[0]) / 2e-3 * 20.0
    both = np.isfinite(rate)
    assert both.mean() > 0.95
    wavelength = SPEED_OF_LIGHT_M_S / fast.radio.carrier_hz
    np.testing.assert_allclose(shift[paths.valid][both], -rate[both] / wavelength, atol=0.5)
    assert np.abs(shift[paths.valid]).max() > 1000.0


def test_snapshots_rotate_by_the_doppler_shift(plan: FloorPlan) -> None:
    """Between snapshots a lone path turns by ``2 pi f_D`` times the interval; the first is that of one."""
    several = updated(
        plan, {"radio.snapshots": 3, "radio.snapshot_interval_s": 2e-4, "radio.agent_array.elements": 2}
    )
    one, anchor = lone(image_paths(several))
    response = receive(several, one, np.array([0]))[0, anchor, :, 0]
    assert response.shape == (3, 2, 819)
    shift = doppler_hz(several, one, np.array([0]))[0, anchor, 0]
    turn = np.exp(2j * np.pi * shift * 2e-4)
    np.testing.assert_allclose(response[1:] / response[:-1], np.full((2, 2, 819), turn), rtol=1e-9)
    still = updated(several, {"radio.snapshots": 1})
    np.testing.assert_array_equal(receive(still, one, np.array([0]))[0, anchor, 0, 0], response[0])


def test_clocks_shift_whole_channels(plan: FloorPlan) -> None:
    """Agent's clock less anchor's: an offset is the same at all times, a drift grows with them."""
    data = plan.model_dump(mode="json")
    data["agent"]["clock"] = {"offset_s": 5e-9, "drift_ppm": 0.001}
    data["anchors"][1]["clock"] = {"offset_s": 2e-9}
    from raytrace.plan.files import parse_floorplan

    error = parse_floorplan({k: v for k, v in data.items() if v is not None}).clock_errors_s()
    np.testing.assert_allclose(error[0], [5e-9, 3e-9])
    np.testing.assert_allclose(error[-1] - error[0], 1e-9 * 39.0)
    np.testing.assert_array_equal(plan.clock_errors_s(), np.zeros((40, 2)))


def test_what_is_not_used_is_not_written(plan: FloorPlan) -> None:
    """A plan without the later fields has the text and hash it had before they existed."""
    text = plan.canonical_json()
    for name in ("clock", "orientation", "snapshots"):
        assert name not in text
    used = updated(plan, {"agent.clock.offset_s": 1e-9, "agent.orientation": "travel", "radio.snapshots": 2})
    assert {"clock", "orientation", "snapshots"} <= {
        word for word in ("clock", "orientation", "snapshots") if word in used.canonical_json()
    }
