"""How runs are judged and summed up: against runs with known errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimator.experiments.cases import Case, limit_of
from estimator.experiments.room import Room
from estimator.experiments.runs import Run, Score, score, slam_of, unmirrored
from estimator.experiments.summary import (
    converged_step,
    limit_curves,
    mean_of,
    rms_of,
    summarise,
)
from estimator.geometry import rotate
from estimator.result import SlamResult

HYBRID = Case("hybrid", "gaussian")


@pytest.fixture(scope="module")
def perfect(walk: Callable[..., Room]) -> tuple[Room, SlamResult]:
    """A room and a result that equals its truth, with covariances of 1 cm^2; the fifth wall comes at 100."""
    room = walk()
    result = slam_of(Run(walk(3), HYBRID, 1, 10))
    steps, walls = room.steps, 5
    agent = np.zeros((steps, 4))
    agent[:, :2] = room.track_m
    small = 1e-4 * np.eye(2)
    valid = np.ones((steps, walls), dtype=bool)
    valid[:100, 4] = False
    return room, replace(
        result,
        agent_mean=agent,
        agent_covariance=np.tile(1e-4 * np.eye(4), (steps, 1, 1)),
        anchor_mean_m=np.tile(room.anchors_m, (steps, 1, 1)),
        anchor_covariance_m2=np.tile(small, (steps, 2, 1, 1)),
        wall_valid=valid,
        wall_mean_m=np.tile(room.scenario.vrps_m[:5], (steps, 1, 1)),
        wall_covariance_m2=np.tile(small, (steps, 5, 1, 1)),
    )


def test_a_perfect_run_has_no_errors(perfect: tuple[Room, SlamResult]) -> None:
    """Truth as estimate gives zeros; the fifth wall's delay counts from its first reflection."""
    room, result = perfect
    judged = score(result, room)
    assert judged.error_m.max() == 0.0
    assert judged.derotated_m.max() < 1e-12
    assert judged.walls_false == 0
    assert not judged.lost
    first = int(np.argmax(room.reflects[:, 4]))
    assert judged.wall_delays == (100.0 - first,)
    missing = np.arange(room.steps)
    expected = np.where((missing >= first) & (missing < 100), 10.0 / 5.0, 0.0)
    np.testing.assert_allclose(judged.ospa_m, expected, atol=1e-12)


def test_a_wall_seen_in_passing_is_none_too_many(perfect: tuple[Room, SlamResult]) -> None:
    """The sixth wall reflects for a moment only: who finds it loses nothing, and a false wall costs 10/6."""
    room, result = perfect
    assert not room.walls_due[-1, 5]

    def more(vrp: np.ndarray) -> Score:
        mean = np.concatenate([result.wall_mean_m, np.tile(vrp, (room.steps, 1, 1))], axis=1)
        valid = np.concatenate([result.wall_valid, np.ones((room.steps, 1), dtype=bool)], axis=1)
        return score(replace(result, wall_mean_m=mean, wall_valid=valid), room)

    with_it, false = more(room.scenario.vrps_m[5]), more(np.array([30.0, 100.0]))
    np.testing.assert_allclose(with_it.ospa_m, score(result, room).ospa_m, atol=1e-12)
    assert with_it.walls_false == 0
    assert false.ospa_m[-1] == pytest.approx(10.0 / 6.0)
    assert false.walls_false == 1


def test_rotation_is_told_from_other_errors(perfect: tuple[Room, SlamResult]) -> None:
    """A map turned by 10 mrad errs by distance times angle, and not at all with the rotation removed."""
    room, result = perfect
    agent = result.agent_mean.copy()
    agent[:, :2] = rotate(agent[:, :2], 0.01)
    judged = score(replace(result, agent_mean=agent, wall_mean_m=rotate(result.wall_mean_m, 0.01)), room)
    assert judged.rotation_rad == pytest.approx(0.01)
    assert judged.derotated_m.max() < 1e-9
    np.testing.assert_allclose(
        judged.error_m, 2.0 * np.sin(0.005) * np.linalg.norm(room.track_m, axis=1), atol=1e-12
    )
    assert judged.walls_false == 0


def test_a_mirrored_map_is_recognised(perfect: tuple[Room, SlamResult]) -> None:
    """The mirror image of a turned perfect map becomes perfect again but for the rotation."""
    room, result = perfect
    flip = np.array([1.0, -1.0])
    agent = result.agent_mean.copy()
    agent[:, :2] = rotate(agent[:, :2] * flip, 0.7)
    twin = replace(result, agent_mean=agent, wall_mean_m=rotate(result.wall_mean_m * flip, 0.7))
    assert score(twin, room).lost
    judged = score(unmirrored(twin, room), room)
    assert judged.derotated_m.max() < 1e-9
    assert judged.walls_false == 0


def test_a_wall_that_is_none_is_false_and_a_missing_one_never_found(
    perfect: tuple[Room, SlamResult],
) -> None:
    """A VRP moved by 20 m makes a false wall, and its true one counts as not found."""
    room, result = perfect
    moved = result.wall_mean_m.copy()
    moved[:, 4] += (20.0, 0.0)
    judged = score(replace(result, wall_mean_m=moved), room)
    assert judged.walls_false == 1
    assert judged.wall_delays == (np.inf,)


def _scores(errors: np.ndarray, delays: tuple[float, ...] = (5.0,)) -> list[Score]:
    steps = np.ones(4)
    return [Score(e * steps, e * steps, e**2 * steps, e * steps, 0.0, 0, delays, 1.0) for e in errors]


def test_standard_errors_are_those_of_many_repetitions() -> None:
    """The claimed Monte-Carlo errors of mean and RMS agree with the spread over 2000 repetitions."""
    samples = np.abs(np.random.default_rng(1).normal(size=(2000, 50)))
    for statistic in (mean_of, rms_of):
        values, errors = np.array([statistic(row) for row in samples], dtype=float).T
        spread = values.std(ddof=1)
        # the spread itself is known to 1 / sqrt(2 n); squares of the claims are averaged
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(spread, rel=5.0 / np.sqrt(2 * 2000) + 0.02)


def test_summary_of_known_scores(walk: Callable[..., Room]) -> None:
    """Means, RMS, medians and counts of made-up runs are what they are; one run has no standard error."""
    room = walk(4)
    numbers = summarise(_scores(np.array([0.3, 0.5])), None, room)
    assert numbers["runs"] == 2
    assert numbers["lost"] == 0
    assert numbers["mae_final_m"] == pytest.approx(0.4)
    assert numbers["mae_final_m_se"] == pytest.approx(0.1)
    assert numbers["rmse_final_m"] == pytest.approx(np.sqrt(0.17))
    assert numbers["converged_step"] == 1
    assert numbers["new_wall_delay_median"] == 5.0
    assert numbers["limit"] is None
    single = summarise(_scores(np.array([2.0])), None, room)
    assert single["lost"] == 1
    assert single["mae_final_m_se"] is None
    assert single["converged_step"] is None
    assert summarise(_scores(np.array([1.0]), (np.inf,)), None, room)["new_wall_delay_median"] is None


def test_convergence_counts_steps_from_one() -> None:
    """The first step below 0.7 m counts, from 1 as the paper's t does."""
    assert converged_step([1.0, 0.8, 0.6, 0.9]) == 3


def test_the_limits_curve_starts_at_the_sensed_walls(walk: Callable[..., Room]) -> None:
    """Nothing but active sensing is known of the walls before the paths: the OSPA limit falls from there."""
    room = walk(30)
    limit = limit_of(room, HYBRID)
    assert limit is not None
    curve = limit_curves(limit, room)["vrp_ospa_m"]
    rayleigh = np.mean(np.sqrt(0.5 * np.pi * np.array(room.sensed_variances_m2)))
    assert 0.3 * rayleigh < curve[0] < rayleigh
    assert curve[-1] < curve[0]
