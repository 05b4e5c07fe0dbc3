"""Walls on loading: ends that nearly meet are joined, and no two surfaces lie at one place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from raytrace.plan.errors import PlanFault
from raytrace.plan.sound_walls import sound_walls
from raytrace.plan.surfaces import Wall


def wall(name: str, start: tuple[float, float], end: tuple[float, float], **more: Any) -> Wall:
    return Wall(name=name, from_m=start, to_m=end, **more)


def spans(walls: tuple[Wall, ...]) -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
    return {each.name: (each.from_m, each.to_m) for each in walls}


def test_sound_walls_keep_their_bits() -> None:
    """Corners and T-joints that are right keep their bits, near the origin and at UTM's distance."""
    for x in (0.0, 500_000.0):
        walls = [
            wall("a", (x, 0.1), (x + 20.3, 7.7)),
            wall("b", (x + 20.3, 7.7), (x + 3.0, 9.0)),
            wall("t", (x + 10.15, 3.9), (x + 9.0, 9.0)),
        ]
        made, repairs = sound_walls(walls)
        assert made == tuple(walls)
        assert repairs.lines() == []


@pytest.mark.parametrize("offset", [0.0, 1e3, 5.4e6])
def test_ends_within_a_millimetre_meet(offset: float) -> None:
    """Gaps and overshoots of tenths of a millimetre at corners and T-joints are closed, anywhere."""
    walls = [
        wall("a", (offset, 0.0), (offset + 10.0, 0.0)),
        wall("corner", (offset + 10.0005, 0.0003), (offset + 10.0, 8.0)),
        wall("tee", (offset + 4.0, 0.0007), (offset + 4.0, 5.0)),
        wall("far", (offset + 6.0, 0.002), (offset + 6.0, 5.0)),
    ]
    made, repairs = sound_walls(walls)
    ends = spans(made)
    assert ends["corner"][0] == ends["a"][1]
    assert ends["tee"][0] == pytest.approx((offset + 4.0, 0.0), abs=1e-9)
    assert ends["far"][0] == walls[3].from_m
    assert repairs.snapped == 2


def test_twins_and_pieces_of_one_material_are_one_wall() -> None:
    """Doubled, reversed, nested and chained walls become the first of them, over all their length."""
    walls = [
        wall("a", (0.0, 0.0), (4.0, 0.0)),
        wall("reversed", (4.0, 0.0), (0.0, 0.0)),
        wall("chained", (7.0, 0.0), (3.0, 0.0)),
        wall("nested", (5.0, 0.0), (6.0, 0.0)),
        wall("beside", (7.0, 0.0), (9.0, 0.0)),
    ]
    made, repairs = sound_walls(walls)
    assert spans(made) == {"a": ((0.0, 0.0), (7.0, 0.0)), "beside": ((7.0, 0.0), (9.0, 0.0))}
    assert "walls 'a' and 'reversed' lie on one another: made one" in repairs.lines()


def test_a_window_stays_and_its_wall_is_cut() -> None:
    """Of two materials of one height the shorter stays; nothing is lost and nothing lies twice."""
    made, repairs = sound_walls(
        [
            wall("brick", (0.0, 0.0), (9.0, 0.0), material="brick"),
            wall("pane", (3.0, 0.0), (5.0, 0.0), material="glass"),
        ]
    )
    assert spans(made) == {
        "brick": ((0.0, 0.0), (3.0, 0.0)),
        "brick-2": ((5.0, 0.0), (9.0, 0.0)),
        "pane": ((3.0, 0.0), (5.0, 0.0)),
    }
    assert repairs.lines() == ["walls 'brick' and 'pane' lie on one another: 'brick' was cut"]


def test_the_higher_of_one_material_stays() -> None:
    """A parapet drawn over a wall does not open a hole above itself."""
    made, _ = sound_walls(
        [wall("wall", (0.0, 0.0), (9.0, 0.0)), wall("low", (2.0, 0.0), (12.0, 0.0), height_m=1.0)]
    )
    assert spans(made) == {"wall": ((0.0, 0.0), (9.0, 0.0)), "low": ((9.0, 0.0), (12.0, 0.0))}


def test_what_no_rule_resolves_is_refused_by_name() -> None:
    """Two materials of two heights at one place: both walls are named with what they are."""
    walls = [
        wall("brick", (0.0, 0.0), (9.0, 0.0), material="brick"),
        wall("pane", (3.0, 0.0), (5.0, 0.0), material="glass", height_m=1.0),
    ]
    with pytest.raises(PlanFault, match=r"'brick' \(brick, 3 m high\) and 'pane' \(glass, 1 m high\)"):
        sound_walls(walls)


def test_mending_is_done_once() -> None:
    """Sound walls are a fixed point: a stored plan is read back with the same hash."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        points = np.round(rng.uniform(0, 5, (12, 2)), 1) + rng.uniform(-6e-4, 6e-4, (12, 2))
        walls = [
            wall(f"w{i}", tuple(map(float, points[i])), tuple(map(float, points[i + 1])))
            for i in range(11)
            if np.linalg.norm(points[i + 1] - points[i]) > 0.1
        ]
        once, _ = sound_walls([*walls, *walls[:2]])
        again, repairs = sound_walls(once)
        assert again == once
        assert repairs.lines() == []
