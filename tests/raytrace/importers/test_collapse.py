"""Double lines become one surface, and ends meet."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import rotate
from raytrace.importers.collapse import collapse
from raytrace.importers.drawing import ImportReport, Line
from raytrace.importers.joins import join_ends
from raytrace.plan.space import enclosed

Points = list[tuple[float, float]]


def line(start: tuple[float, float], end: tuple[float, float], material: str = "concrete") -> Line:
    return Line(start, end, material, 3.0, 0.2, "layer")


def ring(points: Points, material: str = "concrete") -> list[Line]:
    return [line(a, b, material) for a, b in zip(points, points[1:] + points[:1], strict=True)]


def box(x0: float, y0: float, x1: float, y1: float, material: str = "concrete") -> list[Line]:
    return ring([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], material)


def ends(lines: list[Line]) -> set[frozenset[tuple[float, float]]]:
    return {
        frozenset((round(x, 4) + 0.0, round(y, 4) + 0.0) for x, y in (one.start_m, one.end_m))
        for one in lines
    }


def surfaces(lines: list[Line], thickest_m: float = 0.5) -> tuple[list[Line], ImportReport]:
    report = ImportReport()
    return join_ends(collapse(lines, thickest_m, report), report), report


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 2, 2.8])
def test_a_room_of_double_lines_is_its_centre_lines(turn: float) -> None:
    """Outer and inner faces 0.3 m apart give four walls that meet in corners, at any angle."""
    outer, inner = box(0, 0, 8, 6), box(0.3, 0.3, 7.7, 5.7)

    def turned(lines: list[Line]) -> list[Line]:
        return [
            line(*(tuple(rotate(np.array(end), turn).tolist()) for end in (one.start_m, one.end_m)))
            for one in lines
        ]

    walls, _ = surfaces(turned(outer + inner))
    assert ends(walls) == ends(turned(box(0.15, 0.15, 7.85, 5.85)))
    assert {wall.thickness_m for wall in walls} == {0.3}


def test_a_junction_and_a_door_in_a_double_wall() -> None:
    """A partition splits the inner face and ends on the centre line; its door stays a gap with no jambs."""
    outer = box(0, 0, 10, 6)
    left = ring([(0.2, 0.2), (4.95, 0.2), (4.95, 5.8), (0.2, 5.8)])
    right = ring([(5.05, 0.2), (9.8, 0.2), (9.8, 5.8), (5.05, 5.8)])
    # The partition's faces are broken by a door from y = 2 to y = 3, with jambs.
    faces = [
        one for one in left + right if one.start_m[0] != one.end_m[0] or one.start_m[0] not in (4.95, 5.05)
    ]
    for x in (4.95, 5.05):
        faces += [line((x, 0.2), (x, 2.0)), line((x, 3.0), (x, 5.8))]
    jambs = [line((4.95, y), (5.05, y)) for y in (2.0, 3.0)]
    walls, report = surfaces(outer + faces + jambs)
    expected = box(0.1, 0.1, 9.9, 5.9) + [line((5.0, 0.1), (5.0, 2.0)), line((5.0, 3.0), (5.0, 5.9))]
    assert ends(walls) == ends(expected)
    assert report.collapsed["end of a wall, with its faces"] == 2
    start, end = (np.array([getattr(wall, name) for wall in walls]) for name in ("start_m", "end_m"))
    assert enclosed(start, end).area == pytest.approx(9.8 * 5.8, abs=1e-3)


def test_a_window_of_three_lines_is_one_pane() -> None:
    """What is drawn between two faces of the same material goes with them; glass and concrete do not pair."""
    panes = [line((2.0, y), (4.0, y), "glass") for y in (0.0, 0.05, 0.1)]
    walls, _ = surfaces([*panes, line((2.0, 0.2), (4.0, 0.2))])
    assert ends(walls) == ends([line((2.0, 0.05), (4.0, 0.05)), line((2.0, 0.2), (4.0, 0.2))])


def test_a_square_column_keeps_four_surfaces() -> None:
    """Opposite sides of a column are not the faces of a wall, though they are near."""
    column = box(3.0, 3.0, 3.4, 3.4)
    walls, report = surfaces(column)
    assert ends(walls) == ends(column)
    assert not report.collapsed


def test_corridor_walls_do_not_collapse() -> None:
    """Lines farther apart than the thickest wall stay, and the limit is the caller's."""
    corridor = [line((0, 0), (9, 0)), line((0, 0.6), (9, 0.6))]
    assert len(surfaces(corridor)[0]) == 2
    assert len(surfaces(corridor, thickest_m=0.7)[0]) == 1


def test_what_continues_beyond_the_other_face_stays() -> None:
    """A wall of 4 m whose one face goes on for 3 m more: one surface of 4 m, one of 3 m."""
    walls, _ = surfaces([line((0, 0), (7, 0)), line((0, 0.2), (4, 0.2))])
    assert ends(walls) == ends([line((0, 0.1), (4, 0.1)), line((4, 0), (7, 0))])


def test_lines_drawn_twice_and_in_pieces_are_one() -> None:
    """Doubled, reversed and split lines are a single wall; another material takes the place of its part."""
    pieces = [line((0, 0), (3, 0)), line((5, 0), (3, 0)), line((1, 0), (2, 0)), line((0, 0), (3, 0), "glass")]
    walls, report = surfaces(pieces)
    assert ends(walls) == ends([line((3, 0), (5, 0)), line((0, 0), (3, 0), "glass")])
    assert report.collapsed["line continued or drawn twice"] == 2
    assert report.collapsed["line cut where another material lies on it"] == 1


def test_no_two_walls_lie_on_one_another() -> None:
    """A window in the middle of a wall cuts it in two; of a border of two rooms the former's wall stays."""
    walls, report = surfaces([line((0, 0), (9, 0)), line((6, 0.001), (4, 0.001), "glass")])
    assert sorted((piece.material, round(piece.length_m, 3)) for piece in walls) == [
        ("concrete", 3.0),
        ("concrete", 4.0),
        ("glass", 2.0),
    ]
    assert report.collapsed["line cut where another material lies on it"] == 1
    border = [line((5, 0), (5, 4), "brick"), line((5, 4), (5, 0), "wood")]
    assert surfaces(border)[0] == border[:1]


def test_gaps_of_millimetres_close_and_doors_do_not() -> None:
    """Ends of single lines snap over 1 cm at most, and overhanging ones are trimmed."""
    walls, _ = surfaces([line((0, 0), (4.995, 0)), line((5, -0.004), (5, 3)), line((0.05, 1), (0.05, 3))])
    assert ends(walls) == ends([line((0, 0), (5, 0)), line((5, 0), (5, 3)), line((0.05, 1), (0.05, 3))])


def test_untouched_lines_keep_their_bits() -> None:
    """A drawing of single lines that meet comes back exactly as it was."""
    lines = box(0.1, 0.2, 7.3, 4.9)
    assert set(surfaces(lines)[0]) == set(lines)


def test_many_walls_cost_as_many_times_one() -> None:
    """A hundred rooms far from one another become what each becomes alone, caps and jambs with them."""
    room = box(0, 0, 6, 5) + box(0.3, 0.3, 5.7, 4.7)
    spur = [line((3.0, 0.3), (3.0, 2.0)), line((3.1, 0.3), (3.1, 2.0)), line((3.0, 2.0), (3.1, 2.0))]
    alone, _ = surfaces(room + spur)
    places = [(20.0 * (index % 10) + 3.1 * (index // 10), 17.0 * (index // 10)) for index in range(100)]

    def moved(lines: list[Line], dx: float, dy: float) -> list[Line]:
        return [
            line(*((round(x + dx, 6), round(y + dy, 6)) for x, y in (one.start_m, one.end_m)))
            for one in lines
        ]

    walls, report = surfaces([one for dx, dy in places for one in moved(room + spur, dx, dy)])
    assert ends(walls) == set().union(*(ends(moved(alone, dx, dy)) for dx, dy in places))
    assert len(walls) == 100 * len(alone) == 500
    assert report.collapsed["end of a wall, with its faces"] == 100
