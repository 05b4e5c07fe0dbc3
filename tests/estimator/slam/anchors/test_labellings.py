"""Path-to-feature assignments of a place."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from estimator.slam.anchors.labellings import labellings, labellings_at
from estimator.slam.anchors.likelihood import Place
from estimator.slam.anchors.search import Candidates
from tests.estimator.slam.anchors.scenes import ANCHOR, SEARCH, WALLS, mirrored, observed, path_lengths, scene


def enumerated(expected, possible, length, slack=1.2, farthest=3.0):
    """All labellings within ``slack`` of the best, as {labels: cost}."""
    options = [
        [-1, *(j for j in range(len(length)) if possible[c] and abs(length[j] - expected[c]) < farthest)]
        for c in range(len(expected))
    ]
    rated = {}
    for chosen in product(*options):
        used = [j for j in chosen if j >= 0]
        if len(set(used)) == len(used):
            gaps = [length[j] - expected[c] for c, j in enumerate(chosen) if j >= 0]
            rated[chosen] = 0.5 * np.sum(np.square(gaps)) / farthest**2 - len(used)
    best = min(rated.values())
    return {chosen: cost for chosen, cost in rated.items() if cost < best + slack}


@pytest.mark.parametrize("seed", range(12))
def test_branch_and_bound_finds_the_best_of_all(seed):
    """A labelling that is missed is a hypothesis that is missed, if it is the true one."""
    rng = np.random.default_rng(seed)
    given = scene(observed([(0.0, 0.0)]))
    expected = path_lengths(ANCHOR, np.zeros(2))
    length = np.concatenate([expected + rng.normal(0.0, 0.8, 5), rng.uniform(5.0, 60.0, 6)])
    every = enumerated(expected, np.ones(5, dtype=bool), length)
    place = Place(*ANCHOR, 0.0, 0.0, 0.0)
    found = labellings_at(place, given.circles, WALLS, length, 3.0, 1.2, 10_000, 1_000_000)
    assert {tuple(row) for row in found.tolist()} == set(every)
    costs = [every[tuple(row)] for row in found.tolist()]
    assert costs == sorted(costs)
    few = labellings_at(place, given.circles, WALLS, length, 3.0, 1.2, 24, 1_000_000)
    np.testing.assert_allclose([every[tuple(row)] for row in few.tolist()], costs[:24])


def test_no_label_over_a_wall_from_behind_it():
    """The bounce on a wall between anchor and agent does not exist."""
    behind = mirrored(ANCHOR, WALLS[0])
    given = scene(observed([(0.0, 0.0)]))
    length = path_lengths(behind, np.zeros(2))
    found = labellings_at(Place(*behind, 0.0, 0.0, 0.0), given.circles, WALLS, length, 3.0, 1.2, 24, 10_000)
    assert np.all(found[:, 1] == -1)


def test_few_nodes_still_give_a_labelling():
    """Two hundred paths of one length make labellings without number: a bounded time finds something."""
    given = scene(observed([(0.0, 0.0)]))
    length = np.linalg.norm(ANCHOR) + np.linspace(-2.0, 2.0, 200)
    found = labellings_at(Place(*ANCHOR, 0.0, 0.0, 0.0), given.circles, WALLS, length, 3.0, 1.2, 24, 10)
    assert len(found) >= 1
    assert found[0, 0] >= 0


def test_paths_of_similar_length_get_both_labels():
    """Near-equal lengths may be exchanged or left out; a path far from every circle gets no label."""
    given = scene(observed([(0.0, 0.0)]))
    expected = path_lengths(ANCHOR, np.zeros(2))
    length = np.array([expected[0], expected[1] - 0.4, expected[1] + 0.3, 150.0])
    zero, one = np.zeros(1), np.ones(1, dtype=np.int64)
    found = Candidates(ANCHOR[None], np.eye(2)[None], zero, one, one, zero, zero, zero)
    candidate, label = labellings(found, given, length, 10_000, SEARCH)
    chosen = {tuple(row) for row in label[:, :2].tolist()}
    assert set(candidate.tolist()) == {0}
    assert {(0, 1), (0, 2), (0, -1), (-1, 1)} <= chosen
    assert 3 not in label
