"""The search for places of an anchor."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.anchors.cells import Cells, SearchLimits, known_cell
from estimator.slam.anchors.search import evidence_at, find_places, scene_of
from tests.estimator.slam.anchors.scenes import ANCHOR, NOISE, SEARCH, SPREAD, WALLS, observed, scene

LIMITS = SearchLimits(20_000, 80_000, 5, 12, 1000, 60, 600)
AGENTS = [(0.0, 0.0), (0.5, 0.1), (1.0, 0.2)]


def found(given, cells=None, nats=12.0):
    """The places."""
    return find_places(given, known_cell(0.0) if cells is None else cells, LIMITS, nats, SEARCH)


@pytest.mark.parametrize("anchor", [(11.0, 9.0), (-8.0, -6.0), (15.0, -12.0), (-3.0, 20.0)])
def test_the_anchor_is_the_best_place(anchor):
    """A search that prefers another place loses the run."""
    place = np.array(anchor)
    result = found(scene(observed(AGENTS, anchor=place, extra=(33.3, 71.0))))
    np.testing.assert_allclose(result.mean_m[0], place, atol=0.15)
    assert result.matches[0] == 5
    assert result.fresh[0] == 5
    assert np.all(np.diff(result.log_evidence) <= 0.0)


def test_an_unknown_clock_is_found_with_the_place():
    """On a grid of biases, with the error that the grid leaves in the lengths."""
    shift = np.arange(-15.0, 16.0)
    cells = Cells(shift, np.zeros(31), np.zeros(31), np.full(31, -np.log(31.0)))
    given = scene_of(observed(AGENTS, bias=4.3), WALLS, SPREAD, NOISE, SEARCH, 1.0 / 12.0)
    result = found(given, cells)
    assert result.bias_m[0] == 4.0
    assert np.linalg.norm(result.mean_m[0] - ANCHOR) < 0.5


def test_places_are_apart_and_near_the_best_in_evidence():
    """Copies and hopeless places cost hypotheses."""
    result = found(scene(observed(AGENTS[:1], extra=tuple(np.linspace(15.0, 90.0, 12)))), nats=5.0)
    gap = np.linalg.norm(result.mean_m[:, None] - result.mean_m, axis=-1) + 9.0 * np.eye(len(result))
    assert gap.min() > SEARCH.place_radius_m
    assert len(result) <= SEARCH.start_attempts
    assert result.log_evidence[-1] > result.log_evidence[0] - 5.0


def test_the_evidence_at_a_place_is_that_of_the_search():
    """A located anchor is compared with its rivals on one scale."""
    given = scene(observed(AGENTS))
    result = found(given)
    np.testing.assert_allclose(evidence_at(given, result.mean_m, 0.0), result.log_evidence, atol=1e-3)


@pytest.mark.parametrize("walls", [0, 1])
def test_too_little_to_search_gives_few_places_or_none(walls):
    """No wall: no two circles. Nothing may fail."""
    seen = observed(AGENTS, walls=WALLS[:walls])
    given = scene(seen, WALLS[:walls], SPREAD[:walls])
    result = found(given)
    assert len(result) == 0 if walls == 0 else np.all(result.matches <= 2)


def test_no_path_gives_no_place():
    """An anchor that is not heard is nowhere in particular."""
    seen = observed(AGENTS)
    silent = seen._replace(paths=np.zeros(3, dtype=np.int64), first=np.zeros_like(seen.first))
    assert len(found(scene(silent))) == 0


def test_a_place_out_of_the_region_is_none():
    """Nearly parallel circles meet kilometres away."""
    result = found(scene(observed(AGENTS, anchor=np.array([380.0, 0.0]))))
    assert np.all(np.hypot(*result.mean_m.T) < 2.0 * NOISE.region_m)
