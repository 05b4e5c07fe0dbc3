"""What is simulated: rooms, methods with options, and their limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.experiments.cases import OPTIONS, Case, cases_of, limit_of, simulation_with
from estimator.experiments.room import Room, make_room


def test_the_papers_walls_come_first_in_any_order_of_the_plan(walk: Callable[..., Room]) -> None:
    """The variances of Section V-E1 go to x = 0, y = 40, x = 80, y = 0, told by geometry."""
    room = walk()
    vrps = room.scenario.vrps_m[:4] + room.scenario.track_m[0]
    np.testing.assert_allclose(vrps, [[-10, 15], [10, 65], [150, 15], [10, -15]], atol=1e-9)
    assert room.sensed_variances_m2 == (0.08, 0.7, 4.0, 0.2)


def test_other_rooms_get_variances_that_grow_with_the_distance() -> None:
    """In a room that is not the paper's, walls in view get 8.9e-4 of their squared distance; others none."""
    corners = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])
    screen = [[20.0, 5.0], [20.0, 15.0]]  # hides the wall behind it, and shows its own face
    start = np.concatenate([corners, [screen[0]]])
    end = np.concatenate([np.roll(corners, -1, axis=0), [screen[1]]])
    room = make_room("other", start, end, [[25.0, 10.0]], [[5.0, 8.0], [5.5, 8.0]])
    np.testing.assert_allclose(
        room.sensed_variances_m2, 8.9e-4 * np.array([8.0, 12.0, 5.0, 15.0]) ** 2, rtol=1e-12
    )
    assert np.ptp(room.scenario.start_m[4:, 0]) == 0.0
    assert room.scenario.start_m[4, 0] == 30.0


def test_walls_are_due_when_sensed_or_heard(walk: Callable[..., Room]) -> None:
    """A map should have the four sensed walls at once, the fifth when it reflects, and not the edge."""
    due = walk().walls_due
    assert due[0].tolist() == [True] * 4 + [False] * 2
    assert due[-1].sum() == 5
    assert np.all(np.diff(due.astype(int), axis=0) >= 0)


def test_equal_seeds_give_equal_paths_whatever_is_known(walk: Callable[..., Room]) -> None:
    """Methods are compared on the same measurements: knowing the anchors changes nothing else."""
    room = walk(6)
    blind = room.measure(simulation_with(()), 5)
    told = room.measure(simulation_with(()), 5, know_anchors=True)
    assert blind.known_anchors_m is None
    np.testing.assert_allclose(told.known_anchors_m, room.anchors_m)
    for one, other in zip(blind.epochs, told.epochs, strict=True):
        for mine, theirs in zip(one.paths, other.paths, strict=True):
            np.testing.assert_array_equal(mine.delay_s, theirs.delay_s)


def test_cases_have_names_that_make_them_again() -> None:
    """`hybrid+aoa` with an engine is a case; without one, a method brings all its engines, once each."""
    (case,) = cases_of(["hybrid+aoa+sweeps"], "gaussian")
    assert case == Case("hybrid", "gaussian", ("aoa", "sweeps"))
    assert case.key == "hybrid+aoa+sweeps/gaussian"
    keys = [case.key for case in cases_of(["hybrid", "va", "hybrid"], None)]
    assert keys == ["hybrid/gaussian", "hybrid/particle", "va/gaussian", "va/particle"]
    assert len(keys) == len(set(keys))
    assert [case.engine for case in cases_of(["hybrid"], None, every_engine=False)] == ["gaussian"]


@pytest.mark.parametrize(
    ("methods", "engine", "words"),
    [(["hybrit"], None, "hybrid"), (["hybrid+aoe"], None, "aoa"), (["active"], "kalman", "gaussian")],
)
def test_unknown_names_are_answered_with_those_that_exist(
    methods: list[str], engine: str | None, words: str
) -> None:
    """A wrong method, option or engine is refused, and the message lists the right ones."""
    with pytest.raises(ConfigurationError, match=words):
        cases_of(methods, engine)


def test_limits_of_the_papers_room(walk: Callable[..., Room]) -> None:
    """The limits are those known for this room: 0.38 m, less with directions, sweeps or known anchors."""
    room = walk()

    def mae(method: str, *options: str) -> float:
        limit = limit_of(room, Case(method, "gaussian", options))
        assert limit is not None
        return float(limit.position_mae_m[-1])

    assert mae("hybrid") == pytest.approx(0.38, abs=0.01)
    assert mae("hybrid", "clock") == pytest.approx(0.38, abs=0.01)
    assert mae("hybrid", "tdoa") == pytest.approx(0.387, abs=0.01)
    assert mae("hybrid", "sweeps") == pytest.approx(0.13, abs=0.02)
    assert mae("hybrid", "aoa") == pytest.approx(0.107, abs=0.01)
    assert mae("mva") == pytest.approx(0.085, abs=0.005)


def test_where_nothing_holds_the_map_there_is_no_limit(walk: Callable[..., Room]) -> None:
    """Methods without paths, or without anything that fixes the rotation, have no bound to draw."""
    room = walk(8)
    assert limit_of(room, Case("active", "particle")) is None
    assert limit_of(room, Case("passive", "particle")) is None


@pytest.mark.parametrize("name", list(OPTIONS))
def test_options_change_what_is_measured(walk: Callable[..., Room], name: str) -> None:
    """Every option has a meaning: the measurements differ from those without it."""
    room = walk(12)
    plain, other = (room.measure(simulation_with(names), 1) for names in ((), (name,)))
    differs = {
        "aoa": other.epochs[0].paths[0].azimuth_rad is not None,
        "sweeps": bool(other.epochs[10].sweep) and not plain.epochs[10].sweep,
        "clock": other.epochs[0].paths[0].range_m[0] > plain.epochs[0].paths[0].range_m[0] + 5.0,
        "tdoa": np.ptp([epoch.paths[0].range_m[0] for epoch in other.epochs])
        > np.ptp([epoch.paths[0].range_m[0] for epoch in plain.epochs]) + 5.0,
    }
    assert differs[name]
