"""Loops over paired particles against the same sums written out in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.geometry import mirror
from estimator.slam.particle.exponential import EXP_RELATIVE_ERROR
from estimator.slam.particle.pairings import (
    SIGHT,
    VIRTUAL,
    WALL,
    likelihood_sum,
    paired_lengths,
    paired_weights,
)

pytestmark = pytest.mark.interpreted

HEIGHT2 = 2.25


def clouds(particles, seed=0):
    """Agent, anchor and a feature, (2, N) each, some metres apart."""
    rng = np.random.default_rng(seed)
    places = np.array([[5.0, 2.0], [20.0, -4.0], [1.0, 30.0]])
    return [(place[:, None] + rng.normal(size=(2, particles))).astype(np.float32) for place in places]


def exact_lengths(agent, anchor, point, kind, shifts):
    """Lengths (S, N): particle n of the agent with those of index n - shift."""
    lengths = []
    for a, b in shifts:
        source = np.roll(anchor, a, axis=1).astype(np.float64)
        other = np.roll(point, b, axis=1).astype(np.float64)
        source = {SIGHT: source, WALL: mirror(source.T, other.T).T, VIRTUAL: other}[kind]
        lengths.append(np.sqrt(np.sum((agent - source) ** 2, axis=0) + HEIGHT2))
    return np.array(lengths)


@pytest.mark.parametrize("kind", [SIGHT, WALL, VIRTUAL])
@pytest.mark.parametrize("particles", [1, 7, 2048, 5000])
def test_pairs_are_those_of_the_shifts(kind, particles):
    """Whatever the wraps and pieces: every length is that of its pair, and the range that of all."""
    nodes = clouds(particles)
    shifts = np.array([[0, 0], [1, particles - 1], [particles // 3, particles // 2]]) % particles
    length = np.full((3, particles), np.nan, np.float32)
    least, most = paired_lengths(*nodes, kind, shifts, np.float32(HEIGHT2), length)
    assert length == pytest.approx(exact_lengths(*nodes, kind, shifts), abs=2e-5)
    assert (least, most) == (length.min(), length.max())


@pytest.mark.parametrize("count", [5, 32, 1000, 4099])
def test_sums_of_likelihoods(count):
    """Over any number of lengths, whatever the lanes leave over, the sum is the one in double precision."""
    length = np.random.default_rng(1).normal(30.0, 0.3, size=count).astype(np.float32)
    total = likelihood_sum(length, np.float32(30.2), np.float32(4.0))
    exact = np.exp(-((4.0 * (length.astype(np.float64) - np.float32(30.2))) ** 2)).sum()
    assert total == pytest.approx(exact, rel=2.0 * EXP_RELATIVE_ERROR)


@pytest.mark.parametrize("kind", [WALL, VIRTUAL])
def test_weights_are_means_over_the_partners(kind):
    """Each node's particle gets the mean weight of the pairs it is in; an empty array is left alone."""
    particles, shifts = 3000, np.array([[0, 0], [17, 2900], [1500, 1]])
    nodes = clouds(particles, 2)
    exact = exact_lengths(*nodes, kind, shifts)
    path, scale, share = np.array([exact.mean(), 36.0]), np.array([0.5, 2.0]), np.array([3.0, 0.4])
    weight = 0.05 + np.sum(
        share[:, None, None] * np.exp(-(((exact - path[:, None, None]) * scale[:, None, None]) ** 2)), axis=0
    )
    existence = 0.3
    told = existence * weight + 1.0 - existence
    expected = (
        told.mean(axis=0),
        np.mean([np.roll(row, -a) for row, (a, _) in zip(told, shifts, strict=True)], axis=0),
        np.mean([np.roll(row, -b) for row, (_, b) in zip(weight, shifts, strict=True)], axis=0),
    )
    paths = tuple(each.astype(np.float32) for each in (path, scale, share))
    single = np.float32(HEIGHT2), paths, np.float32(0.05), np.float32(existence)
    found = tuple(np.empty(particles, np.float32) for _ in range(3))
    paired_weights(*nodes, kind, shifts, *single, found)
    for mine, theirs in zip(found, expected, strict=True):
        assert mine == pytest.approx(theirs, rel=1e-4)
    alone = (np.empty(particles, np.float32), np.empty(0, np.float32), np.empty(0, np.float32))
    paired_weights(*nodes, kind, shifts, *single, alone)
    assert np.array_equal(alone[0], found[0])
