"""Features: which a hypothesis has, and when geometry allows their paths."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.models.features import MOST_ENTRIES, active_features, gradient, possible_paths, sources
from estimator.slam.models.state_vector import Layout

LAYOUT = Layout(2, 3)
YES, NOBODY = np.ones(3, dtype=bool), np.full(3, -1)


def test_pairs_need_two_found_walls():
    """A double bounce over a wall that may not exist would take the paths of others."""
    located, present = np.array([True, False]), np.array([True, True, True])
    confirmed = np.array([True, False, True])
    active = active_features(LAYOUT, located, present, confirmed, NOBODY)
    assert not active[1].any()
    assert active[0, :4].all()
    pairs = active[0, 4:].reshape(3, 3)
    assert np.argwhere(pairs).tolist() == [[0, 2], [2, 0]]


def test_a_virtual_anchor_is_its_owners_alone():
    """Another anchor never hears it."""
    layout, owner = Layout(2, 3, shared=False), np.array([0, 1, -1])
    active = active_features(layout, np.ones(2, dtype=bool), np.array([True, True, False]), YES, owner)
    assert active.tolist() == [[True, True, False, False], [True, False, True, False]]


def broken(mean, walls):
    """Whether the bounces over walls (from the anchor on) lie between what they connect, step by step."""
    images = [mean[LAYOUT.anchor_xy(0)]]
    for wall in walls:
        v = mean[LAYOUT.wall(wall)]
        images.append(images[-1] + (1.0 - 2.0 * images[-1] @ v / (v @ v)) * v)
    here = mean[:2]
    for wall, image in zip(walls[::-1], images[:0:-1], strict=True):
        v = mean[LAYOUT.wall(wall)]
        one, other = here @ v - 0.5 * v @ v, image @ v - 0.5 * v @ v
        if not one * other < 0.0:
            return False
        here = here + one / (one - other) * (image - here)
    # from the last bounce to the anchor no wall of the path may be crossed: it is on the first wall's side
    return True


def test_possible_paths_are_those_whose_bounces_exist():
    """A path that no beam can take must not be expected; traced back bounce by bounce."""
    rng = np.random.default_rng(3)
    compared = {True: 0, False: 0}
    for _ in range(200):
        mean = 20.0 * rng.normal(size=LAYOUT.size)
        every = active_features(LAYOUT, np.ones(2, dtype=bool), YES, YES, NOBODY)
        possible = possible_paths(LAYOUT, mean, sources(LAYOUT, mean, every), every)
        assert possible[0, 0]
        for i in range(3):
            assert possible[0, 1 + i] == broken(mean, [i])
            for j in range(3):
                if i != j:
                    expected = broken(mean, [i, j])
                    assert possible[0, 4 + 3 * i + j] == expected
                    compared[expected] += 1
    assert min(compared.values()) > 100


def test_a_gradient_has_at_most_its_entries():
    """More entries than there is room for would be written past the end."""
    mean = 10.0 * np.random.default_rng(2).normal(size=LAYOUT.size)
    every = active_features(LAYOUT, np.ones(2, dtype=bool), YES, YES, NOBODY)
    source = sources(LAYOUT, mean, every)
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    for f in np.flatnonzero(every[1]):
        count = gradient(LAYOUT, mean, source, 1, f, 0.6, 0.8, index, value)
        assert count <= MOST_ENTRIES - 2
        assert len(set(index[:count].tolist())) == count
        for axis in range(2):  # a shift of everything along an axis moves agent minus source by mirrors alone
            step = np.zeros(LAYOUT.size)
            step[axis] = 1e-6
            ahead, behind = mean + step, mean - step
            change = (ahead[:2] - behind[:2]) @ [0.6, 0.8] / 2e-6
            assert value[index[:count].tolist().index(axis)] == pytest.approx(change, abs=1e-6)
