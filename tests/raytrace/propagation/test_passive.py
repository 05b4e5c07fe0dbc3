"""Traced paths against the image method: none lost, delays, angles, amplitudes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.files import load_floorplan, shipped_scenes, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.random_plans import KINDS, Kind, random_plan
from raytrace.propagation import passive
from raytrace.propagation.bounces import sharpened
from raytrace.propagation.images import image_paths
from raytrace.propagation.passive import TraceReport, trace_passive, trace_specular
from raytrace.propagation.paths import PathList, PathSet
from raytrace.propagation.scene import RadioScene, build_scene
from raytrace.propagation.solver import solve

Traced = tuple[FloorPlan, RadioScene, PathSet, TraceReport]


def pairs(plan: FloorPlan, traced: PathList, exact: PathList) -> tuple[PathList, PathList]:
    """The paths that both lists hold, in one order."""
    keys = [paths.keys(len(plan.anchors), len(plan.surface_names)) for paths in (traced, exact)]
    _, i, j = np.intersect1d(*keys, return_indices=True)
    return traced.select(i), exact.select(j)


def turn(difference: np.ndarray) -> np.ndarray:
    return np.abs(np.angle(np.exp(1j * difference)))


@pytest.fixture(params=["l_room", "hard_room"])
def room(request: pytest.FixtureRequest) -> Traced:
    return request.getfixturevalue(request.param)


def test_no_path_is_lost(room: Traced) -> None:
    """All 236 positions, both anchors, two bounces: every path of the image method, and no other."""
    _, _, _, report = room
    assert report.missing == 0
    assert report.extra == 0
    assert report.found == report.expected > 5000


def test_first_order_is_complete_without_a_second_look(room: Traced) -> None:
    """The paths of the image method up to one bounce, counted here anew, are all there."""
    plan, _, paths, _ = room
    flat, exact = paths.flat(), image_paths(plan, depth=1, rim_m=1e-3).flat()
    low = flat.select(flat.order <= 1)
    rows = [
        {tuple(row) for row in np.column_stack([p.epoch, p.anchor, p.walls[:, 0]]).tolist()}
        for p in (low, exact)
    ]
    assert rows[1] <= rows[0]


def test_delays_are_those_of_image_geometry(room: Traced) -> None:
    """Absolute delays to a millimetre: nothing was normalised, and single precision is enough."""
    plan, _, paths, _ = room
    traced, exact = pairs(plan, paths.flat(), image_paths(plan).flat())
    assert len(traced) == len(paths.flat())
    assert np.abs(traced.delay_s - exact.delay_s).max() * SPEED_OF_LIGHT_M_S <= 1e-3


def test_angles_are_those_of_image_geometry(room: Traced) -> None:
    """Departure at the anchor and arrival at the agent, azimuth and elevation, in the plan frame."""
    plan, _, paths, _ = room
    traced, exact = pairs(plan, paths.flat(), image_paths(plan).flat())
    for name in (
        "departure_azimuth_rad",
        "departure_elevation_rad",
        "arrival_azimuth_rad",
        "arrival_elevation_rad",
    ):
        assert turn(getattr(traced, name) - getattr(exact, name)).max() < 1e-3, name


def test_the_tracers_own_directions_agree(room: Traced) -> None:
    """Before they are sharpened, directions at both ends are those of image geometry to single precision."""
    plan, radio, _, _ = room
    raw = solve(radio, plan.anchors_m()[0], plan.track(), depth=2, samples=plan.tracing.samples)
    raw, exact = pairs(plan, raw, image_paths(plan, anchors_m=plan.anchors_m()[:1]).flat())
    assert len(raw) > 2000
    for end in ("departure", "arrival"):
        for angle in ("azimuth", "elevation"):
            name = f"{end}_{angle}_rad"
            assert turn(getattr(raw, name) - getattr(exact, name)).max() < 1e-3, name


def test_paths_beside_their_surfaces_are_dropped() -> None:
    """A bounce on one of two walls in a plane does not count for the other; a rim's breadth is allowed."""
    plan = updated(load_floorplan("office"), {"agent.epochs": 60})
    exact = image_paths(plan, depth=1).flat()
    left, right = (plan.surface_names.index(f"front-a{side}") for side in ("1-right", "2-left"))
    there = exact.walls[:, 0] == left
    assert there.sum() > 5
    swapped = replace(exact, walls=np.where(exact.walls == left, right, exact.walls).astype(np.int16))
    kept = sharpened(plan, swapped, plan.track(), plan.anchors_m(), 1e-3, 28e9)
    assert len(kept) == len(exact) - there.sum()
    same = sharpened(plan, exact, plan.track(), plan.anchors_m(), 1e-3, 28e9)
    assert len(same) == len(exact)
    assert len(sharpened(plan, swapped, plan.track(), plan.anchors_m(), 10.0, 28e9)) == len(exact)


def test_a_stretched_room_has_the_same_paths() -> None:
    """With floor and ceiling: the same surfaces in the true scene and in the stretched one, of all paths.

    Seen from above, these are the same paths: their azimuths are those of image geometry.
    """
    plan = updated(load_floorplan("l-room-hard"), {"agent.epochs": 40, "agent.step_m": 2.5})
    radio = build_scene(plan, plan.radio.carrier_hz)
    assert radio.tall.stretch == pytest.approx(80.0 / 3.0)
    exact = image_paths(plan, anchors_m=plan.anchors_m()[:1], rim_m=1e-3, leg_m=0.012).flat()
    for scene, samples in ((radio, 24_000), (radio.tall, 1_000)):
        raw = solve(scene, plan.anchors_m()[0], plan.track(), depth=2, samples=samples)
        traced, image = pairs(plan, raw, exact)
        assert len(traced) > 0.995 * len(exact)  # but for what hash collisions cost
        assert len(raw) < 1.005 * len(exact)
        assert turn(traced.arrival_azimuth_rad - image.arrival_azimuth_rad).max() < 1e-3
        assert turn(traced.departure_azimuth_rad - image.departure_azimuth_rad).max() < 1e-3


def test_rays_of_a_stretched_scene_find_more() -> None:
    """In a long corridor a thousand rays of the stretched scene find more than six thousand of the true."""
    plan = updated(load_floorplan("corridor"), {"agent.epochs": 64, "agent.step_m": 1.2})
    radio = build_scene(plan, plan.radio.carrier_hz)
    exact = image_paths(plan, rim_m=1e-3, leg_m=0.012).flat()
    found = {
        scene.stretch: sum(
            len(pairs(plan, replace(raw, anchor=np.full(len(raw), index)), exact)[0])
            for index, anchor in enumerate(plan.anchors_m())
            for raw in [solve(scene, anchor, plan.track(), depth=2, samples=samples)]
        )
        for scene, samples in ((radio, 6_000), (radio.tall, 1_000))
    }
    assert found[1.0] < found[radio.tall.stretch] <= len(exact)
    assert found[radio.tall.stretch] > 0.99 * len(exact)


@pytest.mark.parametrize("scene", shipped_scenes())
def test_the_tracers_own_gains_are_fresnel(scene: str) -> None:
    """What the tracer says of paths in the true scene: gains are those of free space and slabs."""
    assert_own_gains_are_fresnel(load_floorplan(scene), least=100)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_the_tracers_own_gains_are_fresnel_in_fifty_plans(kind: Kind, seed: int) -> None:
    """The same in ten random plans of every kind."""
    plan = random_plan(kind, np.random.default_rng(1000 + seed), most_epochs=60)
    assert_own_gains_are_fresnel(plan, least=30)


def assert_own_gains_are_fresnel(plan: FloorPlan, least: int) -> None:
    """Traced gains, as they come, against free space times slab reflections, written independently.

    To 0.05 dB in magnitude, of paths that stay 20 cm from every corner and are at most 25 dB weaker than
    over as much free space: nearer, and in the depth of a Brewster null, single precision costs more.
    There have to be more than ``least`` of them.
    """
    source, track = plan.anchors_m()[:1], plan.track()[:64]
    radio = build_scene(plan, plan.radio.carrier_hz)
    raw = solve(radio, source[0], track, depth=2, samples=plan.tracing.samples)
    raw, exact = pairs(plan, raw, image_paths(plan, track, 2, source, rim_m=0.2, leg_m=0.2).flat())
    assert len(raw) > least
    free = SPEED_OF_LIGHT_M_S / plan.radio.carrier_hz / (4 * np.pi * exact.delay_s * SPEED_OF_LIGHT_M_S)
    strong = np.abs(exact.amplitude) > 10 ** (-25 / 20) * free
    assert strong.mean() > 0.5
    ratio = raw.amplitude[strong] / exact.amplitude[strong]
    assert np.abs(20 * np.log10(np.abs(ratio))).max() < 0.05
    assert turn(np.angle(ratio)).max() < 0.1  # a delay error of 2e-4 m at 28 GHz


def test_sharpened_paths_are_those_of_image_geometry(room: Traced) -> None:
    """Delays, gains and directions, near corners too, to double precision."""
    plan, _, paths, _ = room
    traced, exact = pairs(plan, paths.flat(), image_paths(plan, rim_m=-1e-3).flat())
    assert len(traced) == len(paths.flat())
    np.testing.assert_allclose(traced.delay_s, exact.delay_s, rtol=1e-12)
    np.testing.assert_allclose(traced.amplitude, exact.amplitude, rtol=1e-6)
    np.testing.assert_allclose(traced.arrival_azimuth_rad, exact.arrival_azimuth_rad, atol=1e-9)


def test_third_order_too() -> None:
    """Depth 3 is complete as well, on every eighth position."""
    plan = updated(load_floorplan("l-room"), {"tracing.depth": 3})
    radio = build_scene(plan, plan.radio.carrier_hz)
    paths, report = trace_specular(plan, radio, plan.anchors_m(), plan.track()[::8], 3)
    assert (report.missing, report.extra) == (0, 0)
    assert (paths.flat().order == 3).sum() > 100


def test_lost_paths_are_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a call drops paths, their positions are traced again until they are complete."""
    plan = updated(load_floorplan("l-room"), {"agent.epochs": 12})
    radio = build_scene(plan, plan.radio.carrier_hz)
    calls = []

    def forgetful(*args: object, **options: object) -> PathList:
        paths = solve(*args, **options)
        calls.append(len(paths))
        first = len(calls) <= 2
        return paths.select(~((paths.order == 2) & (paths.epoch % 12 == 5))) if first else paths

    monkeypatch.setattr("raytrace.propagation.passive.solve", forgetful)
    paths, report = trace_passive(plan, radio)
    assert report.retraced >= 1
    assert (report.missing, report.extra) == (0, 0)
    assert np.any(paths.order[5] == 2)


def test_two_bounces_at_one_corner_are_not_waited_for() -> None:
    """Where the tracer leaves out legs of less than a centimetre, nothing is missing and nothing retraced.

    At this position the image method has two paths that bounce twice within 5 mm of a corner.
    """
    plan = load_floorplan("l-room")
    place = updated(plan, {"agent.step_m": 0.08, "agent.epochs": 629}).track()[628:]
    every, long_legs = (image_paths(plan, place, 2, plan.anchors_m()[:1], 1e-3, leg) for leg in (0.0, 0.012))
    assert every.valid.sum() == long_legs.valid.sum() + 2
    radio = build_scene(plan, plan.radio.carrier_hz)
    _, report = trace_specular(plan, radio, plan.anchors_m()[:1], place, 2)
    assert (report.missing, report.extra) == (0, 0)
    assert report.expected == long_legs.valid.sum()


def test_what_stays_lost_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracer that never finds double bounces is not believed: the report counts them."""
    plan = updated(load_floorplan("l-room"), {"agent.epochs": 4})
    radio = build_scene(plan, plan.radio.carrier_hz)

    def blind(*args: object, **options: object) -> PathList:
        paths = solve(*args, **options)
        return paths.select(paths.order < 2)

    monkeypatch.setattr("raytrace.propagation.passive.solve", blind)
    monkeypatch.setattr(passive, "_ATTEMPTS", passive._ATTEMPTS[:3])
    _, report = trace_passive(plan, radio)
    exact = image_paths(plan, rim_m=1e-3).flat()
    assert report.missing == (exact.order == 2).sum() > 0
    assert report.found == (exact.order < 2).sum()


def test_positions_and_track_lengths_compile_nothing(l_room: Traced) -> None:
    """Another track, another length, other anchors: the kernels that trace are the same."""
    import drjit as dr

    plan, radio, _, _ = l_room

    def compiled(positions: np.ndarray, anchors: np.ndarray) -> int:
        """Kernels of more than 300 operations (the tracing itself) that were not in memory."""
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            trace_specular(plan, radio, anchors, positions, 2)
            large = [kernel for kernel in dr.kernel_history() if kernel.get("operation_count", 0) > 300]
        assert len(large) >= 3
        return sum(not kernel["cache_hit"] for kernel in large)

    for seed in range(3):
        rng = np.random.default_rng(seed)
        positions = plan.track()[: 60 + 50 * seed] + rng.uniform(0.0, 0.5, 3)
        anchors = plan.anchors_m()[: 1 + seed % 2] + rng.uniform(-1.0, 0.4, 3)
        assert compiled(positions, anchors) == 0
