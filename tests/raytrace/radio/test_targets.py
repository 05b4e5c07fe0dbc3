"""Point targets in the echo: the radar equation, what hides them, and both models of the echo."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan, Target
from raytrace.propagation.directions import directions_of
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.radio.cross_sections import scattering_points, sections_m2
from raytrace.radio.echo import sweep_echo
from raytrace.radio.reception import receive
from raytrace.radio.targets import target_paths, target_returns

PLACE = np.array([10.0, 15.0, 1.5])


def furnished(*targets: dict[str, object], **changes: object) -> FloorPlan:
    data = load_floorplan("l-room").model_dump(mode="json", exclude_none=True)
    data["targets"] = [{"name": f"t{index}", **target} for index, target in enumerate(targets)]
    data["agent"]["epochs"] = changes.pop("agent.epochs", 1)
    return updated(parse_floorplan(data), changes)


def at(range_m: float, azimuth_rad: float, rcs_m2: float) -> dict[str, object]:
    offset = range_m * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    return {"position_m": (PLACE + offset).tolist(), "rcs_m2": rcs_m2}


@pytest.fixture(scope="module")
def empty() -> tuple[FloorPlan, RadioScene]:
    plan = furnished()
    return plan, build_scene(plan, plan.echo.carrier_hz)


@pytest.mark.parametrize("model", ["physical", "radar-equation"])
def test_power_follows_the_radar_equation(empty: tuple[FloorPlan, RadioScene], model: str) -> None:
    """In the beam that looks at it a target returns ``lambda^2 sigma G^2 / ((4 pi)^3 d^4)`` within 0.1 dB.

    What is added to the sweep of the empty room is the target's return alone; ranges and
    sections span a factor of 16 and 1000, so the exponents of both are tested, too.
    """
    plan, radio = empty
    plan = updated(plan, {"echo.model": model})
    without = sweep_echo(plan, radio).response[0]
    beams, grid = plan.echo.beams.beam_set(), plan.echo.grid()
    beam = 5
    azimuth = float(beams.azimuths()[beam])
    gain = np.abs(beams.two_way(azimuth)[beam]) ** 2
    assert gain == pytest.approx((16 * 10**0.8) ** 2, rel=0.6)  # 16 elements, 8 dBi each, off boresight
    wavelength = SPEED_OF_LIGHT_M_S / plan.echo.carrier_hz
    for range_m, section in ((1.5, 0.01), (6.0, 1.0), (24.0, 10.0)):
        plan_with = furnished(at(range_m, azimuth, section), **{"echo.model": model})
        added = sweep_echo(plan_with, radio).response[0, beam] - without[beam]
        delay = 2.0 * np.hypot(range_m, 0.5 * plan.echo.separation_m) / SPEED_OF_LIGHT_M_S
        matched = np.mean(added * np.exp(2j * np.pi * grid.offsets_hz() * delay))
        expected = wavelength**2 * section * gain / ((4 * np.pi) ** 3 * range_m**4)
        assert abs(10 * np.log10(np.abs(matched) ** 2 / expected)) < 0.1
        phase = np.exp(-2j * np.pi * plan.echo.carrier_hz * delay)
        assert np.angle(matched * np.conj(phase * beams.two_way(azimuth)[beam])) == pytest.approx(
            0.0, abs=0.05
        )


def test_walls_hide_targets() -> None:
    """Behind the inner corner of the L a target is not heard; the count says how many are."""
    seen, hidden = (
        {"position_m": [20.0, 20.0, 1.0], "rcs_dbsm": 0.0},
        {"position_m": [60.0, 55.0, 1.0], "rcs_m2": 1.0},
    )
    plan = furnished(seen, hidden)
    returns, _ = target_returns(plan, PLACE, PLACE)
    assert len(returns) == 1
    np.testing.assert_allclose(returns.delay_s * SPEED_OF_LIGHT_M_S, 2 * np.linalg.norm([10.0, 5.0, 0.5]))
    sweep = sweep_echo(plan)
    assert sweep.targets == 1
    assert sweep.as_dict()["targets"] == 1
    assert "targets" not in sweep_echo(furnished()).as_dict()
    assert len(target_returns(furnished(), PLACE, PLACE)[0]) == 0


def test_decibels_over_a_square_metre() -> None:
    """``rcs_dbsm`` is ten times the logarithm of ``rcs_m2``."""
    target = Target(name="person", position_m=(1.0, 1.0, 1.0), rcs_dbsm=-3.0)
    assert target.section_m2 == pytest.approx(0.501, rel=1e-3)
    assert Target(name="chair", position_m=(1.0, 1.0, 1.0), rcs_m2=0.2).section_m2 == 0.2


def body(kind: str, *way: tuple[float, float], **more: object) -> dict[str, object]:
    return {"kind": kind, "waypoints_m": [list(point) for point in way], **more}


@pytest.mark.parametrize("kind", ["human", "vehicle", "agv"])
def test_sections_are_those_of_the_standard(kind: str) -> None:
    """Between random directions, and straight back, sections equal those of the ray tracer's own tables."""
    pytest.importorskip("sionna.rt", reason="the ray tracer is not installed")
    from raytrace.propagation.backend import prepare

    prepare()
    import mitsuba as mi
    from sionna.rt.rcs import TR38901RCS
    from sionna.rt.rcs.tr38901.parameters import get_target_parameters

    name = {"human": "human"}.get(kind, f"{kind}-multi-sp")
    parameters = get_target_parameters(name, 2)
    target = Target.model_validate({"name": "t", **body(kind, (0.0, 0.0))})
    rng = np.random.default_rng(4)
    points = len(scattering_points(target))
    towards = rng.standard_normal((2, 200, points, 3))
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    towards[1, :50] = towards[0, :50]
    ours = sections_m2(target, towards[0], towards[1])
    for point in range(points):
        lobes = parameters.lobes if points == 1 else parameters.lobes[point : point + 1]
        theirs = TR38901RCS(
            lobes=lobes,
            k1=parameters.k1,
            k2=parameters.k2,
        )
        sent, heard = (mi.Vector3f(np.float32(part[:, point]).T) for part in (-towards[0], towards[1]))
        section = np.asarray(theirs(sent, heard).numpy(), dtype=np.float64)
        np.testing.assert_allclose(10 * np.log10(ours[:, point] / section), 0.0, atol=1e-3)


@pytest.mark.parametrize("kind", ["human", "vehicle", "agv"])
def test_bodies_return_what_the_radar_equation_gives(kind: str) -> None:
    """Alone in a room, a body in front of the device returns its points' echoes, summed, within 0.1 dB."""
    plan = furnished(body(kind, (20.0, 15.0), heading_deg=180.0))
    target = plan.targets[0]
    returns, _ = target_returns(plan, PLACE, PLACE)
    points = np.array([20.0, 15.0, 0.0]) + scattering_points(target) * (-1.0, -1.0, 1.0)
    assert len(returns) == len(points)
    away = points - PLACE
    distance = np.linalg.norm(away, axis=1)
    inward = -away / distance[:, None] * (-1.0, -1.0, 1.0)
    wavelength = SPEED_OF_LIGHT_M_S / plan.echo.carrier_hz
    power = wavelength**2 * sections_m2(target, inward, inward) / ((4 * np.pi) ** 3 * distance**4)
    np.testing.assert_allclose(20 * np.log10(np.abs(returns.amplitude)), 10 * np.log10(power), atol=0.1)
    np.testing.assert_allclose(returns.delay_s, 2 * distance / SPEED_OF_LIGHT_M_S)
    if kind == "human":  # the peak of the front's lobe, 5 mm off its axis at 10 m
        assert 10 * np.log10(sections_m2(target, inward, inward)[0]) == pytest.approx(2.14, abs=0.01)


def test_points_share_the_section() -> None:
    """A rigid pair of points along the line of sight interferes as its spacing says."""
    spacing = 0.25 * SPEED_OF_LIGHT_M_S / 28e9  # a quarter of a wavelength: there and back half a turn
    pair = {**at(8.0, 0.0, 2.0), "points_m": [[0.0, 0.0, 0.0], [spacing, 0.0, 0.0]]}
    returns, _ = target_returns(furnished(pair), PLACE, PLACE)
    alone, _ = target_returns(furnished(at(8.0, 0.0, 1.0)), PLACE, PLACE)
    np.testing.assert_allclose(np.abs(returns.amplitude), np.abs(alone.amplitude[0]), rtol=1e-3)
    assert np.abs(returns.amplitude.sum()) < 1e-2 * np.abs(alone.amplitude[0])


def test_targets_go_to_and_fro() -> None:
    """Along the way-points and back; the front looks ahead, the velocity is that of the track."""
    target = Target.model_validate(
        {"name": "t", **body("human", (0.0, 0.0), (4.0, 0.0), (4.0, 3.0), speed_m_s=2.0)}
    )
    times = np.array([0.0, 1.0, 2.0, 3.0, 3.5, 4.0, 5.0, 7.0, 9.0])
    motion = target.motion(times)
    places = [(0, 0), (2, 0), (4, 0), (4, 2), (4, 3), (4, 2), (4, 0), (0, 0), (4, 0)]
    np.testing.assert_allclose(motion.place_m[:, :2], places, atol=1e-12)
    step = 1e-6
    later = target.motion(times + step).place_m
    np.testing.assert_allclose((later - motion.place_m) / step, motion.velocity_m_s, atol=1e-5)
    np.testing.assert_allclose(
        2.0 * np.stack([np.cos(motion.azimuth_rad), np.sin(motion.azimuth_rad)], axis=1),
        motion.velocity_m_s[:, :2],
        atol=1e-12,
    )


def test_doppler_is_the_change_of_the_path() -> None:
    """Shifts of echoes and of anchors' signals over a moving body: minus the lengths' rates over lambda."""
    way = body("vehicle", (14.0, 12.0), (30.0, 20.0), speed_m_s=5.0)
    plan = furnished(way, **{"agent.epochs": 3})
    epochs, step = np.array([1]), 1e-5

    def lengths(late_s: float) -> tuple[np.ndarray, np.ndarray]:
        moved = plan.track()[1] + late_s * plan.velocities_m_s()[1]
        motion = plan.targets[0].motion(plan.times_s()[[1]] + late_s)
        c, s = np.cos(motion.azimuth_rad[0]), np.sin(motion.azimuth_rad[0])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        points = motion.place_m[0] + scattering_points(plan.targets[0]) @ turn.T
        back = np.linalg.norm(points - moved, axis=1)
        there = np.linalg.norm(points[None] - plan.anchors_m()[:, None], axis=-1)
        return 2.0 * back, there + back

    wavelength = SPEED_OF_LIGHT_M_S / plan.echo.carrier_hz
    before, after = lengths(-step), lengths(step)
    echo, passive = ((b - a) / (2 * step) / wavelength for b, a in zip(before, after, strict=True))
    place = plan.track()[1]
    np.testing.assert_allclose(target_returns(plan, place, place, 1)[1], echo, rtol=1e-5)
    paths, shift = target_paths(plan, epochs)
    assert paths.valid.all()
    np.testing.assert_allclose(shift[0], passive, rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(paths.delay_s[0] * SPEED_OF_LIGHT_M_S, lengths(0.0)[1])


def test_beams_of_a_sweep_see_returns_turn() -> None:
    """With an interval between beams a return's phase turns by its shift from beam to beam."""
    way = {"rcs_m2": 1.0, "waypoints_m": [[20.0, 15.0], [30.0, 15.0]], "speed_m_s": 3.0, "height_m": 1.5}
    still, swept = (furnished(way, **{"echo.beam_interval_s": s}) for s in (0.0, 1.25e-4))
    place = still.track()[0]
    _, shift = target_returns(still, place, place)
    empty = (furnished(**{"echo.beam_interval_s": s}) for s in (0.0, 1.25e-4))
    one, other = (
        sweep_echo(plan).response[0] - sweep_echo(bare).response[0]
        for plan, bare in zip((still, swept), empty, strict=True)
    )
    heard = np.abs(one[:, 0]) > 0.1 * np.abs(one).max()
    turn = np.angle(other[heard, 0] / one[heard, 0])
    expected = 2 * np.pi * 1.25e-4 * shift[0] * np.flatnonzero(heard)
    np.testing.assert_allclose(np.exp(1j * turn), np.exp(1j * expected), atol=0.2)


def test_bodies_scatter_what_anchors_send() -> None:
    """The channel with a body less that without is the body's bistatic return, and its shadow elsewhere."""
    plan = furnished(body("human", (20.0, 15.0)))
    paths, shift = target_paths(plan, np.array([0]))
    assert paths.valid.shape == (1, len(plan.anchors), 1)
    gain = np.abs(paths.amplitude[0, :, 0])
    towards = directions_of(paths.departure_azimuth_rad[0, :, 0], paths.departure_elevation_rad[0, :, 0])
    chest = np.array([20.0, 15.0, 1.5])
    there = np.linalg.norm(chest - plan.anchors_m(), axis=1)
    back = np.linalg.norm(chest - plan.track()[0])
    np.testing.assert_allclose(plan.anchors_m() + there[:, None] * towards, np.tile(chest, (len(there), 1)))
    wavelength = SPEED_OF_LIGHT_M_S / plan.radio.carrier_hz
    section = gain**2 * (4 * np.pi) ** 3 * there**2 * back**2 / wavelength**2
    assert np.all((10 * np.log10(section) < 2.15) & (10 * np.log10(section) > 2.14 - 7.71))
    assert receive(plan, paths, np.array([0]), shift).shape[1] == len(plan.anchors)
    assert target_paths(furnished(at(5.0, 0.0, 1.0)), np.array([0]))[0].valid.size == 0
