"""Both echo models against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import vrp_of_line
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan, shipped_scenes, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.images import image_paths
from raytrace.propagation.passive import TraceReport, trace_specular
from raytrace.propagation.paths import PathSet
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.propagation.solver import solve
from raytrace.radio.channel import superpose
from raytrace.radio.echo import sweep_echo
from raytrace.radio.radar_equation import horizontal_hits, radar_sweep

Traced = tuple[FloorPlan, RadioScene, PathSet, TraceReport]


def wall_hits(plan: FloorPlan, place: np.ndarray, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First walls along horizontal rays by planar geometry: distance and cosine of incidence."""
    start, end = plan.walls_m()
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)[:, None]
    along = (end - start)[None]
    gap = start[None] - place[:2]
    determinant = towards[..., 0] * along[..., 1] - towards[..., 1] * along[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (gap[..., 0] * along[..., 1] - gap[..., 1] * along[..., 0]) / determinant
        share = (gap[..., 0] * towards[..., 1] - gap[..., 1] * towards[..., 0]) / determinant
    distance = np.where((distance > 0) & (share >= 0) & (share <= 1), distance, np.inf)
    wall = np.argmin(distance, axis=1)
    normal = np.stack([-along[0, :, 1], along[0, :, 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return distance.min(axis=1), np.abs(np.sum(normal[wall] * towards[:, 0], axis=-1))


def test_physical_echo_is_the_sum_of_images_through_beams(l_room: Traced) -> None:
    """The traced sweep equals image paths from the sender to the receiver, weighted by both beams."""
    plan, radio, _, _ = l_room
    sweep = sweep_echo(plan, radio)
    assert sweep.report is not None
    assert (sweep.report.missing, sweep.report.extra) == (0, 0)
    half = np.array([0.0, 0.0, 0.5 * plan.echo.separation_m])
    place = plan.track()[0]
    exact = image_paths(plan, (place - half)[None], 2, (place + half)[None]).flat()
    exact = exact.select(exact.order > 0)
    assert sweep.specular == len(exact) == 8  # four walls in view, three corners and a pair of walls
    beams, grid = plan.echo.beams.beam_set(), plan.echo.grid()
    weights = (
        beams.one_way(exact.departure_azimuth_rad, exact.departure_elevation_rad)
        * beams.one_way(exact.arrival_azimuth_rad, exact.arrival_elevation_rad)
        * exact.amplitude[:, None]
    )
    expected = superpose(weights.T, exact.delay_s, grid)
    assert np.abs(sweep.response[0] - expected).max() < 0.02 * np.abs(expected).max()


def test_flash_gives_the_virtual_reference_point(l_room: Traced) -> None:
    """The strongest returns lie at half the distance to the VRPs, in their directions."""
    plan, radio, _, _ = l_room
    response = sweep_echo(plan, radio).response[0]
    grid, beams = plan.echo.grid(), plan.echo.beams.beam_set()
    taps = np.abs(np.fft.ifft(response, n=8 * grid.tones, axis=-1))
    ranges = np.arange(8 * grid.tones) / (8 * grid.tones * grid.tone_spacing_hz) * SPEED_OF_LIGHT_M_S / 2
    start, end = plan.walls_m()
    place = plan.track()[0, :2]
    offsets = vrp_of_line(start, end, place) - place
    seen = [wall.name in {"west", "south", "east", "north-left"} for wall in plan.walls]
    for offset in offsets[seen]:
        azimuth = np.arctan2(offset[1], offset[0])
        beam = int(np.argmin(np.abs(np.angle(np.exp(1j * (beams.azimuths() - azimuth))))))
        distance = ranges[np.argmax(taps[beam])]
        assert distance == pytest.approx(0.5 * np.linalg.norm(offset), abs=0.1)


def test_flash_power_falls_as_the_square_of_the_distance(l_room: Traced) -> None:
    """A wall is a mirror, not a point: power as d^-2, whatever the radar equation says."""
    plan, radio, _, _ = l_room
    power = {}
    for x in (5.0, 10.0, 20.0):
        place, half = np.array([[x, 20.0, 1.5]]), np.array([0.0, 0.0, 0.025])
        paths = trace_specular(plan, radio, place + half, place - half, 1)[0].flat()
        west = paths.select(paths.walls[:, 0] == 0)
        assert len(west) == 1
        power[x] = float(np.abs(west.amplitude[0]) ** 2)
    assert power[5.0] / power[10.0] == pytest.approx(4.0, rel=1e-3)
    assert power[10.0] / power[20.0] == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("scene", shipped_scenes())
def test_flashes_as_traced_are_those_of_theory(scene: str) -> None:
    """As the tracer says them, before they are sharpened: to a millimetre and 0.05 dB of a slab's mirror.

    From eight places along the walk, of bounces that stay 20 cm from every rim.
    """
    plan = load_floorplan(scene)
    radio = build_scene(plan, plan.echo.carrier_hz)
    half = np.array([0.0, 0.0, 0.5 * plan.echo.separation_m])
    flashes = 0
    for place in plan.track()[:: plan.agent.epochs // 8]:
        ends = ((place + half)[None], (place - half)[None])
        exact = image_paths(plan, ends[1], 1, ends[0], rim_m=0.2).flat()
        raw = solve(radio, ends[0][0], ends[1], depth=1, samples=24_000, los=False)
        for wall, delay_s, amplitude in zip(raw.walls[:, 0], raw.delay_s, raw.amplitude, strict=True):
            mine = exact.select((exact.order == 1) & (exact.walls[:, 0] == wall))
            if len(mine):
                assert abs(delay_s - mine.delay_s[0]) * SPEED_OF_LIGHT_M_S < 1e-3
                assert abs(20 * np.log10(abs(amplitude) / abs(mine.amplitude[0]))) < 0.05
                flashes += 1
    assert flashes >= 8


def test_hits_are_planar_geometry(l_room: Traced) -> None:
    """Distances and angles of incidence of horizontal rays to a tenth of a millimetre."""
    plan, radio, _, _ = l_room
    azimuth = np.linspace(0.013, 2 * np.pi, 500)
    place = plan.track()[0]
    distance, cosine = horizontal_hits(radio, place, azimuth)
    expected_distance, expected_cosine = wall_hits(plan, place, azimuth)
    np.testing.assert_allclose(distance, expected_distance, atol=1e-4)
    np.testing.assert_allclose(cosine, expected_cosine, atol=1e-5)


def test_rays_that_meet_nothing() -> None:
    """Above the walls of a room without a ceiling nothing returns."""
    plan = updated(load_floorplan("l-room"), {"echo.model": "radar-equation"})
    radio = build_scene(plan, plan.echo.carrier_hz)
    distance, cosine = horizontal_hits(radio, np.array([10.0, 15.0, 5.0]), np.array([0.0, 1.0]))
    assert np.isinf(distance).all()
    assert not cosine.any()
    assert not radar_sweep(plan, radio, np.array([10.0, 15.0, 5.0]), 0.0, np.zeros(3)).any()


def test_pencil_beams_are_equation_7(l_room: Traced) -> None:
    """Beam by beam: gain times b(f) / d^2 and the phase of the two-way delay, (7), on planar hits."""
    plan, radio, _, _ = l_room
    plan = updated(
        plan, {"echo.model": "radar-equation", "echo.fan_rays": 0, "echo.gamma": 2.0, "echo.eta": 0.7}
    )
    response = sweep_echo(plan, radio).response[0]
    beams, grid = plan.echo.beams.beam_set(), plan.echo.grid()
    distance, cosine = wall_hits(plan, plan.track()[0], beams.azimuths())
    gain = np.abs(np.diagonal(beams.two_way(beams.azimuths())))
    wavelength = SPEED_OF_LIGHT_M_S / (28e9 + grid.offsets_hz())
    section = 2.0 * cosine ** (2 * 0.7)
    b = np.sqrt(section[:, None] / (4 * np.pi) ** 3) * wavelength
    np.testing.assert_allclose(np.abs(response), gain[:, None] * b / distance[:, None] ** 2, rtol=1e-4)
    turns = np.unwrap(np.angle(response), axis=1)
    slope = (turns[:, -1] - turns[:, 0]) / (grid.offsets_hz()[-1] - grid.offsets_hz()[0])
    np.testing.assert_allclose(slope, -2 * np.pi * 2 * distance / SPEED_OF_LIGHT_M_S, rtol=1e-5)


def test_fan_is_the_weighted_sum_of_its_rays(l_room: Traced) -> None:
    """Real beams: rays summed one by one with the beam's pattern, of unit power, times its gain."""
    plan, radio, _, _ = l_room
    plan = updated(plan, {"echo.model": "radar-equation", "echo.fan_rays": 360, "echo.subcarriers": 40})
    response = sweep_echo(plan, radio).response[0]
    beams, grid = plan.echo.beams.beam_set(), plan.echo.grid()
    azimuth = np.deg2rad(np.arange(360.0))
    distance, cosine = horizontal_hits(radio, plan.track()[0], azimuth)
    for beam in (0, 21, 63):
        pattern = beams.two_way(azimuth)[:, beam]
        gain = beams.two_way(beams.azimuths()[beam])[beam]
        pattern = gain * pattern / gain / np.sqrt(np.sum(np.abs(pattern / gain) ** 2))
        total = np.zeros(grid.tones, dtype=complex)
        for ray in range(360):
            frequency = 28e9 + grid.offsets_hz()
            b = SPEED_OF_LIGHT_M_S / frequency * np.sqrt(cosine[ray] ** 0.4 / (4 * np.pi) ** 3)
            phase = np.exp(-2j * np.pi * frequency * 2 * distance[ray] / SPEED_OF_LIGHT_M_S)
            total += pattern[ray] * b / distance[ray] ** 2 * phase
        np.testing.assert_allclose(response[beam], total, rtol=1e-6)


def test_heading_turns_the_beams(l_room: Traced) -> None:
    """An agent turned by a panel's width sees the same sweep with the panels renumbered."""
    plan, radio, _, _ = l_room
    straight = sweep_echo(plan, radio).response[0].reshape(4, 16, -1)
    turned = sweep_echo(updated(plan, {"agent.heading_deg": 90.0}), radio).response[0].reshape(4, 16, -1)
    np.testing.assert_allclose(turned, np.roll(straight, -1, axis=0), atol=1e-5 * np.abs(straight).max())


def test_rough_walls_add_diffuse_returns(hard_room: Traced) -> None:
    """With scattering on, diffuse returns join the specular ones, and stay the weaker part."""
    plan, radio, _, _ = hard_room
    both = sweep_echo(plan, radio)
    specular = sweep_echo(updated(plan, {"tracing.diffuse": False}), radio)
    assert both.diffuse > 1000
    assert specular.diffuse == 0
    share = np.sum(np.abs(both.response - specular.response) ** 2) / np.sum(np.abs(specular.response) ** 2)
    assert 1e-4 < share < 1.0
