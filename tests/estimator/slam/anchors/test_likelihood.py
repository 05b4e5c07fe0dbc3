"""Gated pairs of circles and paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.slam.anchors.likelihood import Place, gate_epoch, is_behind, room_for, walls_between
from estimator.slam.anchors.observations import gathered
from estimator.slam.anchors.search import scene_of
from tests.estimator.slam.anchors.scenes import (
    ANCHOR,
    NOISE,
    SEARCH,
    SPREAD,
    WALLS,
    mirrored,
    observed,
    scene,
)


def gated(given, place, first=0, last=None):
    """The gated pairs of the last epoch as {circle: [(path, relative)]}."""
    circles, seen = given.circles, given.seen
    last = circles.x.shape[1] if last is None else last
    out = room_for(circles.x.shape[1], given.model.max_gated)
    gate_epoch(place, circles, seen, len(circles.x) - 1, first, last, given.vrp_m, given.model, out)
    found = {}
    for q in range(first, last):
        pairs = range(out.begin[q], out.begin[q + 1])
        found[q] = [(int(out.path[i]), float(out.relative[i])) for i in pairs]
    return found


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("height2", [0.0, 4.0])
def test_the_table_finds_what_a_search_of_all_pairs_finds(seed, height2):
    """A path lost between table and gate would be clutter; a wrong density would weigh it wrongly."""
    rng = np.random.default_rng(seed)
    lengths, variance = rng.uniform(5.0, 90.0, 30), rng.uniform(0.01, 0.5, 30)
    ratio = rng.uniform(0.5, 3.0, 30)
    seen = gathered(rng.uniform(-1.0, 1.0, (1, 2)), 0.3 * np.eye(2)[None], [(lengths, variance, ratio)])
    given = scene_of(seen, WALLS, 10.0 * SPREAD, NOISE, replace(SEARCH, max_gated=30))
    place = Place(*rng.uniform(-10.0, 10.0, 2), 0.7, height2, 0.5 * height2)
    order = np.argsort(lengths)
    found = gated(given, place)
    total = 0
    for q, pairs in found.items():
        c = given.circles
        offset = np.array([place.x - c.x[0, q], place.y - c.y[0, q]])
        slant = np.sqrt(offset @ offset + height2)
        spread = offset @ [[c.xx[0, q], c.xy[0, q]], [c.xy[0, q], c.yy[0, q]]] @ offset / slant**2
        total_variance = spread + variance[order]
        total_variance = total_variance + (0.25 * height2 / slant) ** 2
        square = (lengths[order] - slant - 0.7) ** 2 / total_variance
        expected = {}
        for j in np.flatnonzero(square < 16.0):
            density = np.exp(-0.5 * square[j]) / np.sqrt(2.0 * np.pi * total_variance[j])
            expected[int(j)] = density / NOISE.clutter_density * (ratio[order][j] if q == 0 else 1.0)
        assert dict(pairs) == pytest.approx(expected, rel=1e-9)
        total += len(pairs)
    assert total > 5


def test_of_many_paths_the_nearest_are_compared():
    """However many paths pile up, a circle takes a bounded number of them, and not the worst."""
    length = np.linalg.norm(ANCHOR)
    crowd = length + np.linspace(-0.3, 0.3, 101)
    seen = gathered(np.zeros((1, 2)), 0.01 * np.eye(2)[None], [(crowd, np.full(101, 0.01), np.ones(101))])
    pairs = gated(scene(seen), Place(*ANCHOR, 0.0, 0.0, 0.0), 0, 1)[0]
    nearest = np.argsort(np.abs(crowd - length), kind="stable")[: SEARCH.max_gated]
    gap = np.abs(crowd[[j for j, _ in pairs]] - length)
    assert len(pairs) == SEARCH.max_gated
    assert gap.max() <= np.abs(crowd[nearest] - length).max() + 1e-9


def test_nothing_is_heard_over_a_wall_from_behind_it():
    """A place behind a wall would explain that wall's path as well as its image in front of it."""
    behind = mirrored(ANCHOR, WALLS[0])
    given = scene(observed([(0.0, 0.0)], anchor=behind))
    assert is_behind(*behind, *WALLS[0])
    assert gated(given, Place(*behind, 0.0, 0.0, 0.0))[1] == []
    assert gated(given, Place(*behind, 0.0, 0.0, 0.0))[0]
    assert walls_between(*behind, WALLS) == 1
    assert walls_between(*ANCHOR, WALLS) == 0
