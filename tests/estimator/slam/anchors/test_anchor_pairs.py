"""Hybrid SLAM with anchors elsewhere, at full length: nothing is tuned to the places of the paper's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from estimator.evaluation.metrics import best_rotation, derotated, nees
from estimator.slam import run_slam
from estimator.specular import specular_paths
from tests.estimator.slam.conftest import Room

OTHER_PAIR = ((75.0, 5.0), (65.0, 55.0))
_AWAY_M = 2.0  # from walls


def heard_at_once(room: Room) -> np.ndarray:
    """Number of paths of each anchor in the first epoch, (2,)."""
    paths = specular_paths(room.walls[:, 0], room.walls[:, 1], room.anchors, room.track[:1], 1)
    return np.asarray(paths.visible[0].sum(axis=-1))


def random_pairs(room: Room, count: int, seed: int) -> list[Room]:
    """Rooms with two anchors anywhere in the L that each have at least four paths in the first epoch."""
    rng, rooms = np.random.default_rng(seed), []
    while len(rooms) < count:
        anchors = rng.uniform((_AWAY_M, _AWAY_M), (80.0 - _AWAY_M, 60.0 - _AWAY_M), (2, 2))
        if np.any((anchors[:, 0] < 50.0 + _AWAY_M) & (anchors[:, 1] > 40.0 - _AWAY_M)):
            continue
        candidate = Room(room.walls, anchors, room.track)
        if np.all(heard_at_once(candidate) >= 4):
            rooms.append(candidate)
    return rooms


def outcomes(room: Room, seeds: range) -> np.ndarray:
    """De-rotated errors of the tracks (RMS) and at their ends, m, and NEES per dimension there, (N, 3)."""
    truth, rows = room.track - room.track[0], []
    for seed in seeds:
        result = run_slam(room.measure(seed))
        track = result.agent_mean[:, :2]
        error = np.linalg.norm(derotated(track, float(best_rotation(track, truth))) - truth, axis=1)
        honest = nees(track[-1:] - truth[-1:], result.agent_covariance[-1:, :2, :2])[0]
        rows.append((np.sqrt(np.mean(error**2)), error[-1], honest))
    return np.array(rows)


def judge(found: np.ndarray, record: Callable[[str, object], None]) -> None:
    """At most 2 % lost, de-rotated RMSE at most 0.2 m, NEES from 0.6 to 1.8."""
    kept = found[found[:, 0] < 1.0]
    lost, rmse, honest = len(found) - len(kept), np.sqrt(np.mean(kept[:, 1] ** 2)), np.mean(kept[:, 2])
    record("of all", f"{lost} of {len(found)} lost, de-rotated RMSE {rmse:.3f} m, NEES {honest:.2f}")
    assert lost <= 0.02 * len(found)
    assert rmse <= 0.2
    assert 0.6 <= honest <= 1.8


@pytest.mark.soak
def test_the_other_pair(room: Room, record_property: Callable[[str, object], None]) -> None:
    """A hundred runs with the anchors (75, 5) and (65, 55)."""
    there = Room(room.walls, np.array(OTHER_PAIR), room.track)
    judge(outcomes(there, range(8001, 8101)), record_property)


@pytest.mark.soak
def test_ten_random_pairs(room: Room, record_property: Callable[[str, object], None]) -> None:
    """Ten pairs of anchors, ten runs each."""
    rooms = random_pairs(room, 10, 2)
    found = [outcomes(each, range(8201 + 100 * i, 8211 + 100 * i)) for i, each in enumerate(rooms)]
    for each, rows in zip(rooms, found, strict=True):
        rmse = np.sqrt(np.mean(rows[:, 1] ** 2))
        record_property(f"anchors {np.round(each.anchors, 1).tolist()}", f"de-rotated RMSE {rmse:.3f} m")
    judge(np.concatenate(found), record_property)


def test_two_pairs_briefly(room: Room) -> None:
    """Two random pairs, three runs of forty epochs each: none lost."""
    for i, each in enumerate(random_pairs(room, 2, 3)):
        short = Room(each.walls, each.anchors, each.track[:40])
        assert np.all(outcomes(short, range(8601 + i, 8604 + i))[:, 0] < 1.0)
