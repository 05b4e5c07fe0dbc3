"""Plans far from the origin: the same paths, echoes and rays as beside it, whatever the offset."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from raytrace.plan.files import parse_floorplan
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.passive import trace_passive
from raytrace.propagation.paths import PathSet
from raytrace.propagation.scene import build_scene
from raytrace.radio.radar_equation import horizontal_hits

# A kilometre, 200 km, UTM (zone 32), and a fourth of the way around the Earth.
OFFSETS = [(1e3, -1e3), (2e5, 2e5), (500_000.0, 5_400_000.0), (1e7, -1e7)]


def room(dx: float, dy: float) -> FloorPlan:
    """A room of 20 m x 12 m with a T-joined partition and a floor, moved."""

    def at(x: float, y: float) -> list[float]:
        return [dx + x, dy + y]

    corners = [(0, 0), (20, 0), (20, 12), (0, 12)]
    ends = [*zip(corners, corners[1:] + corners[:1], strict=True), ((7, 0), (7, 4.5))]
    data: dict[str, Any] = {
        "format": "hapslam-floorplan",
        "version": 1,
        "name": "far",
        "walls": [{"name": f"w{i}", "from_m": at(*a), "to_m": at(*b)} for i, (a, b) in enumerate(ends)],
        "floor": {},
        "anchors": [{"name": "pa1", "position_m": [*at(4.125, 6.25), 1.75]}],
        "agent": {"waypoints_m": [at(10, 6), at(16, 6.5)], "epochs": 6, "smoothing_m": 0.0},
    }
    return parse_floorplan(data)


def by_name(paths: PathSet) -> dict[tuple[int, ...], tuple[float, complex]]:
    flat = paths.flat()
    names = [(int(epoch), *map(int, walls)) for epoch, walls in zip(flat.epoch, flat.walls, strict=True)]
    return dict(zip(names, zip(flat.delay_s, flat.amplitude, strict=True), strict=True))


@pytest.fixture(scope="module")
def near() -> dict[tuple[int, ...], tuple[float, complex]]:
    paths, report = trace_passive(room(0.0, 0.0))
    assert (report.missing, report.extra) == (0, 0)
    assert report.found > 60
    return by_name(paths)


@pytest.mark.parametrize("offset", OFFSETS)
def test_paths_are_the_same_whatever_the_offset(
    offset: tuple[float, float], near: dict[tuple[int, ...], tuple[float, complex]]
) -> None:
    """No path is lost, none is new, and delays agree to a picosecond: a third of a millimetre."""
    paths, report = trace_passive(room(*offset))
    far = by_name(paths)
    assert (report.missing, report.extra) == (0, 0)
    assert far.keys() == near.keys()
    delays = np.array([(far[name][0], near[name][0]) for name in near])
    assert np.abs(delays[:, 0] - delays[:, 1]).max() < 1e-12
    gains = np.array([(far[name][1], near[name][1]) for name in near])
    assert np.abs(gains[:, 0] - gains[:, 1]).max() < 1e-4 * np.abs(gains).max()


def test_rays_of_the_radar_equation_start_where_the_agent_is() -> None:
    """Distances to the walls in four directions, at UTM's coordinates."""
    plan = room(500_000.0, 5_400_000.0)
    place = np.array([500_010.0, 5_400_004.0, 1.5])
    distance, cosine = horizontal_hits(
        build_scene(plan, plan.echo.carrier_hz), place, np.array([0.0, 0.5, 1.0, 1.5]) * np.pi
    )
    np.testing.assert_allclose(distance, [10.0, 8.0, 3.0, 4.0], atol=1e-4)
    np.testing.assert_allclose(cosine, 1.0, atol=1e-5)


def test_plans_beside_the_origin_stay_where_they_are() -> None:
    """Moving is by multiples of 256 m: what lies around the origin is traced in the coordinates it has."""
    scene = build_scene(room(0.0, 0.0), 28e9)
    np.testing.assert_array_equal(scene.origin_m, 0.0)
    far = build_scene(room(500_000.0, 5_400_000.0), 28e9)
    assert np.all(np.abs(far.placed(np.array([500_010.0, 5_400_006.0, 1.5]))) < 200.0)
