"""Where an agent may walk: rooms behind doors, streets, the open; never closets or cavities."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
import shapely

from estimator.errors import ConfigurationError, InputError
from raytrace.plan.files import load_floorplan, shipped_scenes
from raytrace.plan.placement import place_anchors, plan_walk
from raytrace.plan.space import Space, SpaceConfig, SpaceKind, confined, enclosed, main_space, spaces
from raytrace.plan.trajectory import smoothed_track

Segments = list[tuple[Sequence[float], Sequence[float]]]


def path(*points: Sequence[float]) -> Segments:
    return list(itertools.pairwise(points))


def box(x: float, y: float, width: float, depth: float) -> Segments:
    return path((x, y), (x + width, y), (x + width, y + depth), (x, y + depth), (x, y))


def walls(segments: Segments, thickness: float = 0.2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    ends = np.array(segments, dtype=float)
    return ends[:, 0], ends[:, 1], np.full(len(ends), thickness)


def main(segments: Segments, kind: SpaceKind | None = None) -> Space:
    return main_space(*walls(segments), kind)


def holds(space: Space, x: float, y: float) -> bool:
    return bool(shapely.contains_xy(space.free, x, y))


def test_shipped_scenes_keep_their_area() -> None:
    """Where nothing needs bridging the confined area is exactly that of the walls' polygons."""
    for name in shipped_scenes():
        start, end = load_floorplan(name).walls_m()
        assert confined(start, end).equals(enclosed(start, end)), name


@pytest.mark.parametrize("gap", [0.7, 1.0, 1.9])
def test_a_door_does_not_let_the_room_out(gap: float) -> None:
    """A room with a door's gap in its outer wall is a room, of the area that its walls would enclose."""
    segments = path((0, 6), (0, 0), (20, 0), (20, 12), (0, 12), (0, 6 + gap))
    space = main(segments)
    assert space.kind == "inside"
    assert space.area_m2 == pytest.approx(240, rel=0.02)
    assert not holds(space, -1, 6)


def test_closets_shafts_and_cavities_are_not_taken() -> None:
    """Of a room, a shaft in it and the cavity of its double wall, the room is the main space."""
    segments = [*box(0, 0, 8, 5), *box(-0.8, -0.8, 9.6, 6.6), *box(3, 2, 1.5, 1.5)]
    space = main(segments)
    assert holds(space, 1, 1)
    assert not holds(space, 3.75, 2.75)
    assert not holds(space, -0.4, 2)


def test_doors_join_rooms_and_narrow_gaps_do_not() -> None:
    """Rooms joined by a door of 80 cm are one space; a slot of 50 cm, through which nobody walks, is none."""
    outer = box(0, 0, 10, 5)
    door = main([*outer, ((5, 0), (5, 2)), ((5, 2.8), (5, 5))])
    assert door.share == pytest.approx(1, abs=0.01)
    slot = main([*outer, ((6, 0), (6, 2)), ((6, 2.5), (6, 5))])
    assert slot.share == pytest.approx(0.6, abs=0.02)
    assert not holds(slot, 8, 2)


def test_a_street_is_between_its_buildings() -> None:
    """Four blocks at a crossing: the agent walks on the street, or inside a block if the user says so."""
    blocks = [edge for x in (0, 30) for y in (0, 30) for edge in box(x, y, 20, 20)]
    street = main(blocks)
    assert street.kind == "outside"
    assert street.area_m2 == pytest.approx(900, rel=0.01)
    assert holds(street, 25, 25)
    assert main(blocks, "inside").area_m2 == pytest.approx(400, rel=0.01)


def test_a_house_with_a_shed_is_no_street() -> None:
    """A second building that is small beside the first does not turn the agent out of the house."""
    assert main([*box(0, 0, 20, 20), *box(30, 0, 3, 3)]).kind == "inside"


def test_single_reflectors_and_canyons_are_scenes() -> None:
    """One wall has its surroundings on both sides; between two walls one walks between them."""
    alone = main(path((0, 0), (9, 0)))
    assert holds(alone, 4, 3)
    assert holds(alone, 4, -3)
    canyon = main([*path((0, 0), (100, 0)), *path((0, 15), (100, 15))])
    assert canyon.kind == "outside"
    assert not holds(canyon, 50, 17)
    track = plan_walk(*walls(path((0, 0), (9, 0))))
    assert len(track.waypoints_m) > 1


def test_what_is_too_narrow_is_told() -> None:
    """A plan of 40 cm in all has no space inside, and the message says how wide the walls stand."""
    with pytest.raises(InputError, match=r"space inside to walk 0.3 m .* span 0.4 m by 0.4 m"):
        main(box(0, 0, 0.4, 0.4), "inside")


def test_all_spaces_are_told_largest_first() -> None:
    """Two rooms without a door between them are two spaces with their shares."""
    found = [
        space for space in spaces(*walls([*box(0, 0, 10, 5), ((7, 0), (7, 5))])) if space.kind == "inside"
    ]
    assert [round(space.share, 1) for space in found] == [0.7, 0.3]


def test_a_walk_finds_doors_that_fall_between_the_points_of_its_lattice() -> None:
    """In a large building with narrow doors the walk leaves its first room: routes are where space is."""
    size, door = 60.0, 0.7
    segments = box(0, 0, size, size)
    for x in range(5, 60, 5):
        segments += [((x, 0), (x, 30.0)), ((x, 30.0 + door), (x, size))]
    start, end, thickness = walls(segments, 0.1)
    walk = plan_walk(start, end, thickness, most_epochs=400)
    track = smoothed_track(walk.waypoints_m, walk.smoothing_m, walk.step_m, walk.epochs)
    assert len(np.unique(track[:, 0] // 5)) >= 4


def test_anchors_hang_in_the_space_of_the_walk() -> None:
    """No anchor goes into the cavity of a double wall or a shaft, from where nothing is seen."""
    start, end, thickness = walls([*box(0, 0, 8, 5), *box(-0.8, -0.8, 9.6, 6.6), *box(3, 2, 1.5, 1.5)])
    walk = plan_walk(start, end, thickness)
    track = smoothed_track(walk.waypoints_m, walk.smoothing_m, walk.step_m, walk.epochs)
    room = main_space(start, end, thickness)
    for x, y in place_anchors(start, end, thickness, track):
        assert holds(room, x, y)


def test_a_large_building_is_searched_where_the_walk_can_get() -> None:
    """In a passage of a kilometre the walk starts where it is told, and anchors hang within their range."""
    start, end, thickness = walls(box(0.0, 0.0, 1000.0, 3.0))
    walk = plan_walk(start, end, thickness, most_epochs=100, start_at_m=(800.0, 1.5))
    places = np.array(walk.waypoints_m)
    assert np.linalg.norm(places[0] - (800.0, 1.5)) < 1.0
    track = smoothed_track(walk.waypoints_m, walk.smoothing_m, walk.step_m, walk.epochs)
    assert np.ptp(track[:, 0]) > 30.0
    anchors = place_anchors(start, end, thickness, track, range_m=5.0)
    assert anchors[:, 0].min() >= track[:, 0].min() - 5.0
    assert anchors[:, 0].max() <= track[:, 0].max() + 5.0


def test_a_configuration_is_checked() -> None:
    """A door of no width would bridge nothing, in silence."""
    with pytest.raises(ConfigurationError, match="door_m: expected metres above 0, got 0"):
        SpaceConfig(door_m=0.0)
