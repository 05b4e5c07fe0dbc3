"""The image method against a lattice of images, reciprocity, and planar geometry."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from estimator.geometry import mirror_in_wall
from estimator.specular import specular_paths
from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.materials import permittivity, slab_reflection
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import NO_SURFACE, PathList
from raytrace.propagation.reflectors import surfaces_of

SIZE = np.array([8.0, 6.0, 3.0])


def shoebox(**more: Any) -> FloorPlan:
    x, y, z = SIZE
    corners = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)]
    return parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "shoebox",
            "walls": [
                {"name": f"w{i}", "from_m": corners[i], "to_m": corners[(i + 1) % 4], "height_m": z}
                for i in range(4)
            ],
            "floor": {},
            "ceiling": {},
            "anchors": [{"name": "pa1", "position_m": (6.3, 4.1, 2.2)}],
            "agent": {"waypoints_m": [(1.7, 2.3), (3.1, 1.1)], "smoothing_m": 0.0, "epochs": 3},
            "tracing": {"depth": 3},
            **more,
        }
    )


def lattice_lengths(source: np.ndarray, target: np.ndarray, order: int) -> np.ndarray:
    """Path lengths of one order in a box: images at ``2 n L + s`` and ``2 n L - s`` along each axis."""
    lengths = []
    for cells in product(range(-3, 4), repeat=3):
        for flips in product((0, 1), repeat=3):
            bounces = sum(abs(2 * n - flip) for n, flip in zip(cells, flips, strict=True))
            if bounces == order:
                n, flip = np.array(cells), np.array(flips)
                image = 2 * n * SIZE + np.where(flip, -source, source)
                lengths.append(np.linalg.norm(image - target))
    return np.sort(lengths)


def test_shoebox_has_the_whole_lattice() -> None:
    """In a box every image is seen exactly once: 1, 6, 18 and 38 paths, with the lattice's lengths."""
    plan = shoebox()
    paths = image_paths(plan).flat()
    for epoch, position in enumerate(plan.track()):
        for order, count in enumerate((1, 6, 18, 38)):
            mine = (paths.epoch == epoch) & (paths.order == order)
            lengths = np.sort(paths.delay_s[mine]) * SPEED_OF_LIGHT_M_S
            expected = lattice_lengths(plan.anchors_m()[0], position, order)
            assert len(expected) == count
            np.testing.assert_allclose(lengths, expected, rtol=1e-12)


def test_paths_are_reciprocal() -> None:
    """Exchanging anchor and agent reverses every path: same delay and gain, angles and walls exchanged."""
    plan = updated(load_floorplan("l-room-hard"), {"agent.epochs": 1, "tracing.depth": 3})
    anchor, agent = plan.anchors_m()[:1], np.array([[30.0, 20.0, 1.2]])

    def by_walls(paths: PathList, reverse: bool) -> dict[tuple[int, ...], int]:
        rows = [tuple(w for w in row if w != NO_SURFACE) for row in paths.walls.tolist()]
        return {row[::-1] if reverse else row: index for index, row in enumerate(rows)}

    there = image_paths(plan, agent, anchors_m=anchor).flat()
    back = image_paths(plan, anchor, anchors_m=agent).flat()
    ours, theirs = by_walls(there, reverse=False), by_walls(back, reverse=True)
    assert set(ours) == set(theirs)
    assert len(ours) > 50
    i = np.array([ours[walls] for walls in ours])
    j = np.array([theirs[walls] for walls in ours])
    np.testing.assert_allclose(there.delay_s[i], back.delay_s[j], rtol=1e-12)
    np.testing.assert_allclose(there.amplitude[i], back.amplitude[j], rtol=1e-6)
    np.testing.assert_allclose(there.arrival_azimuth_rad[i], back.departure_azimuth_rad[j], atol=1e-9)
    np.testing.assert_allclose(there.departure_elevation_rad[i], back.arrival_elevation_rad[j], atol=1e-9)


def test_first_order_is_the_planar_mirror_image() -> None:
    """A single bounce has the length to the virtual anchor of equation (2), heights added."""
    plan = load_floorplan("l-room")
    start, end = plan.walls_m()
    track, anchors = plan.track(), plan.anchors_m()
    paths = image_paths(plan, depth=1).flat()
    single = paths.select(paths.order == 1)
    wall = single.walls[:, 0]
    virtual = mirror_in_wall(anchors[single.anchor, :2], start[wall], end[wall])
    planar = np.linalg.norm(virtual - track[single.epoch, :2], axis=1)
    rise = anchors[single.anchor, 2] - track[single.epoch, 2]
    np.testing.assert_allclose(single.delay_s * SPEED_OF_LIGHT_M_S, np.hypot(planar, rise), rtol=1e-12)


def test_the_edge_blocks() -> None:
    """Around the corner of the L there is no line of sight, and no wall is seen through another."""
    plan = load_floorplan("l-room")
    hidden = np.array([[65.0, 55.0, 1.5]])  # anchor pa2 at (42, 36): the corner (50, 40) stands between
    shown = np.array([[65.0, 38.0, 1.5]])
    assert 0 not in image_paths(plan, hidden, 0, plan.anchors_m()[1:]).flat().order
    assert 0 in image_paths(plan, shown, 0, plan.anchors_m()[1:]).flat().order


def test_low_wall_does_not_block_above_it() -> None:
    """A partition lower than the line of sight neither blocks it nor reflects above its rim."""
    data = shoebox().model_dump(mode="json", exclude_none=True)
    low = {"name": "low", "from_m": [4.0, 0.0], "to_m": [4.0, 6.0], "height_m": 1.0}
    high = {**low, "height_m": 3.0}
    track = shoebox().track()
    for wall, seen in ((low, True), (high, False)):
        plan = parse_floorplan({**data, "walls": [*data["walls"], wall]})
        line_of_sight = image_paths(plan, track, depth=0).valid[:, 0, 0]
        assert np.all(line_of_sight == seen)


def test_amplitudes_are_fresnel_times_free_space() -> None:
    """At equal heights the field is across the plane of incidence: free space times the TE coefficient."""
    plan = load_floorplan("l-room")
    anchor, agent = np.array([[68.0, 6.0, 1.5]]), np.array([[30.0, 20.0, 1.5]])
    paths = image_paths(plan, agent, 1, anchor).flat()
    carrier_hz = plan.radio.carrier_hz
    free = 10 ** (-free_space_loss_db(paths.delay_s * SPEED_OF_LIGHT_M_S, carrier_hz) / 20)
    phase = np.exp(-2j * np.pi * carrier_hz * paths.delay_s)
    line_of_sight = paths.order == 0
    expected = (free * phase)[line_of_sight]
    np.testing.assert_allclose(paths.amplitude[line_of_sight], expected, rtol=1e-9)

    single = paths.select(paths.order == 1)
    normal = surfaces_of(plan).normal[single.walls[:, 0], :2]
    towards = np.column_stack([np.cos(single.arrival_azimuth_rad), np.sin(single.arrival_azimuth_rad)])
    cosine = np.abs(np.sum(normal * towards, axis=1))
    te, _ = slab_reflection(cosine, permittivity("concrete", carrier_hz), 0.2, carrier_hz)
    np.testing.assert_allclose(single.amplitude, te * (free * phase)[paths.order == 1], rtol=1e-6)


def test_scattering_takes_its_share_from_the_specular_path() -> None:
    """With S = 0.3 every bounce keeps 1 - S^2 of its power."""
    plain, rough = shoebox(), shoebox(scattering={"concrete": 0.3})
    smooth, dim = image_paths(plain).flat(), image_paths(rough).flat()
    np.testing.assert_allclose(
        dim.amplitude / smooth.amplitude, (1 - 0.3**2) ** (0.5 * smooth.order), rtol=1e-9
    )


def test_rim_leaves_out_what_a_corner_decides() -> None:
    """A bounce 0.5 mm from a corner counts for a rim of a micrometre and not for one of a millimetre."""
    plan = shoebox()
    anchor = np.array([[6.0, 3.0, 1.5]])
    # Bounce on w0 (y = 0) at x = 0.0005: the agent lies on the line from the image (6, -3) through it.
    agent = np.array([[0.0005 - 5.9995 * 0.00002, 0.00006, 1.5]])
    walls = [
        image_paths(plan, agent, 1, anchor, rim_m=rim).flat().walls[:, 0].tolist() for rim in (1e-6, 1e-3)
    ]
    assert 0 in walls[0]
    assert 0 not in walls[1]


def test_rim_is_measured_across_the_ray() -> None:
    """A bounce 5 mm from the end of a grazed wall passes it by half a millimetre: it is left out."""
    data = shoebox().model_dump(mode="json", exclude_none=True)
    screen = {"name": "screen", "from_m": [2.0, 3.0], "to_m": [4.0, 3.0], "height_m": 3.0}
    plan = parse_floorplan({**data, "walls": [*data["walls"], screen]})
    number = len(data["walls"])
    slope = 0.1
    for before_end, rims in ((0.005, (True, False)), (0.1, (True, True))):
        x = 4.0 - before_end
        start = np.array([[x - 0.3 / slope, 2.7, 1.5]])
        agent = np.array([[x + 0.3 / slope, 2.7, 1.5]])
        seen = [
            number in image_paths(plan, agent, 1, start, rim_m=rim).flat().walls[:, 0] for rim in (1e-6, 1e-3)
        ]
        assert seen == list(rims)


def test_planar_method_agrees() -> None:
    """The estimator's own planar image method gives the same paths, lengths apart from the heights."""
    plan = load_floorplan("l-room")
    start, end = plan.walls_m()
    planar = specular_paths(start, end, plan.anchors_m()[:, :2], plan.track()[:, :2], order=2)
    ours = image_paths(plan, depth=2).flat()
    column = {walls: index for index, walls in enumerate(planar.walls)}
    rows = [tuple(w for w in row if w != NO_SURFACE) for row in ours.walls.tolist()]
    index = np.array([column[walls] for walls in rows])
    seen = np.zeros_like(planar.visible)
    seen[ours.epoch, ours.anchor, index] = True
    np.testing.assert_array_equal(seen, planar.visible)
    length = np.hypot(planar.length_m[ours.epoch, ours.anchor, index], 1.0)  # heights 2.5 m and 1.5 m
    np.testing.assert_allclose(ours.delay_s * SPEED_OF_LIGHT_M_S, length, rtol=1e-12)


def test_blocks_of_positions_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking at three positions at a time gives what looking at all at once gives."""
    plan = updated(load_floorplan("l-room"), {"agent.epochs": 10})
    whole = image_paths(plan).flat()
    monkeypatch.setattr("raytrace.propagation.images._PAIRS", 100)
    pieces = image_paths(plan).flat()
    np.testing.assert_array_equal(whole.delay_s, pieces.delay_s)
    np.testing.assert_array_equal(whole.walls, pieces.walls)
    np.testing.assert_array_equal(whole.epoch, pieces.epoch)


def test_chosen_sequences_alone() -> None:
    """Asked for some sequences, of all orders and one of them twice, it gives their paths and no others.

    Sequences with a gap, or of surfaces that are not there, have none.
    """
    plan = updated(load_floorplan("l-room"), {"agent.epochs": 30})
    whole = image_paths(plan).flat()
    none = NO_SURFACE
    among = np.array([[0, none], [1, 0], [1, 0], [none, none]], dtype=np.int16)
    some = image_paths(plan, among=among).flat()
    wanted = (whole.walls[:, None] == among).all(axis=2).any(axis=1)
    assert set(whole.order[wanted]) == {0, 1, 2}
    np.testing.assert_array_equal(some.walls, whole.walls[wanted])
    np.testing.assert_array_equal(some.delay_s, whole.delay_s[wanted])
    assert image_paths(plan, among=np.array([[none, 1], [0, 99]], dtype=np.int16)).valid.sum() == 0


@pytest.mark.parametrize("depth", [0, 2])
def test_walls_are_padded_to_the_depth(depth: int) -> None:
    """The bounce axis has the depth's length (at least one), unused slots hold NO_SURFACE."""
    paths = image_paths(shoebox(), depth=depth)
    assert paths.walls.shape[-1] == max(depth, 1)
    flat = paths.flat()
    np.testing.assert_array_equal(np.sum(flat.walls != NO_SURFACE, axis=1), flat.order)


def test_paths_at_a_corner_are_told_apart_by_the_rim() -> None:
    """A bounce 0.4 mm beyond the end of its wall exists with a rim of -1 mm alone; others do not change.

    The agent stands where the double reflection over "north-left" and "east" is just about to appear.
    """
    plan = load_floorplan("l-room")
    place = np.array([[51.66369971, 10.83363003, 1.5]])
    strict, usual, lenient = (
        image_paths(plan, place, 2, plan.anchors_m()[1:], rim_m=rim).flat() for rim in (1e-3, 1e-6, -1e-3)
    )
    walls = [{tuple(row) for row in paths.walls.tolist()} for paths in (strict, usual, lenient)]
    assert walls[0] == walls[1]
    assert walls[2] - walls[1] == {(5, 2)}


def jointed(*extra: tuple[list[float], list[float]]) -> FloorPlan:
    """A room of 10 m x 8 m with walls more in it."""
    corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]]
    ends = [*zip(corners, corners[1:] + corners[:1], strict=True), *extra]
    return parse_floorplan(
        {
            "format": "hapslam-floorplan",
            "version": 1,
            "name": "jointed",
            "walls": [{"name": f"w{i}", "from_m": a, "to_m": b} for i, (a, b) in enumerate(ends)],
            "anchors": [{"name": "pa", "position_m": [3.0, 5.0, 2.0]}],
            "agent": {"waypoints_m": [[2.0, 2.0], [4.5, 2.0]], "smoothing_m": 0.0, "epochs": 2},
        }
    )


def orders(plan: FloorPlan, agent: tuple[float, float], anchor: tuple[float, float], rim_m: float) -> set:
    """Surfaces of the paths of one bounce at most, at the height of 1.5 m."""
    paths = image_paths(plan, np.array([[*agent, 1.5]]), 1, np.array([[*anchor, 1.5]]), rim_m=rim_m)
    return {int(wall) for wall in paths.walls[0, 0, paths.valid[0, 0], 0]}


@pytest.mark.parametrize("rim_m", [1e-6, 1e-3])
def test_a_bounce_at_the_foot_of_a_wall_is_the_rims(rim_m: float) -> None:
    """A wall that ends on another hides what bounces at its foot, and nothing a centimetre beside it.

    With a negative rim the path is there: the tracer may find it, and is not wrong.
    """
    plan = jointed(([5.0, 0.0], [5.0, 1.0]))
    assert 0 not in orders(plan, (2.0, 2.0), (8.0, 2.0), rim_m)
    assert 0 in orders(plan, (2.0, 2.0), (8.0, 2.0), -rim_m)
    beside = jointed(([5.0 + 0.02, 0.0], [5.0 + 0.02, 0.005]))
    assert 0 in orders(beside, (2.0, 2.0), (8.0, 2.0), rim_m)


@pytest.mark.parametrize("rim_m", [1e-6, 1e-3])
def test_a_line_of_sight_within_a_wall_is_the_rims(rim_m: float) -> None:
    """A line of sight along a wall, or through its end, is not expected; beside it, it is."""
    plan = jointed(([5.0, 3.0], [5.0, 6.0]))
    for agent, anchor, seen in (
        ((5.0, 2.0), (5.0, 7.0), False),  # along the wall
        ((5.0, 1.0), (5.0, 2.5), True),  # in its plane, before it
        ((2.0, 3.0), (8.0, 3.0), False),  # through its end
        ((2.0, 2.99), (8.0, 2.99), True),
    ):
        assert (-1 in orders(plan, agent, anchor, rim_m)) is seen
    assert -1 in orders(plan, (5.0, 2.0), (5.0, 7.0), -rim_m)


def test_nothing_warns_in_the_plane_of_a_wall() -> None:
    """Anchors and agents in the planes of walls give numbers and no warning, whatever the rim."""
    plan = jointed(([5.0, 3.0], [5.0, 6.0]), ([5.0, 0.0], [5.0, 1.0]))
    places = np.array([[5.0, 2.0, 1.5], [5.0, 7.0, 1.5], [2.0, 2.0, 1.5]])
    for rim_m in (1e-6, 0.0, 1e-3, -1e-3):
        paths = image_paths(plan, places, 2, places[::-1] + [0.0, 0.0, 0.3], rim_m=rim_m)
        assert np.isfinite(paths.delay_s[paths.valid]).all()
        assert paths.valid.any(axis=2).all(where=np.eye(3)[::-1] == 0)
