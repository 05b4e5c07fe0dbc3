"""Lines among unassociated paths: enough support, in one line, strong enough, and bounded in time."""

from __future__ import annotations

import time

import numpy as np
import pytest

from estimator.slam.gaussian.births.config import Births
from estimator.slam.gaussian.births.lines import find_line, most_overlap
from estimator.slam.models.path_buffer import PathBuffer, Track

ANY = np.array([np.inf, np.inf])  # limit of losses
CONFIG = Births()


def buffer_of(epoch, anchor, length, loss=np.nan, unassociated=True):
    """Paths of an agent that walks half a metre an epoch."""
    order = np.argsort(epoch, kind="stable")
    count = len(epoch)
    given = epoch, anchor, length, np.full(count, 0.1), loss, unassociated
    columns = [np.broadcast_to(each, count)[order].copy() for each in given]
    track = np.arange(18)
    place = np.stack([0.5 * track, np.zeros(18)], axis=1)
    return PathBuffer(Track(track, place, np.full(18, 0.05)), *columns)


EPOCH = np.arange(18)
LENGTH = 60.0 - 0.3 * EPOCH


def found(buffer, limit=ANY, **changes):
    return find_line(buffer, 17, limit, 0.02, Births(**changes))


def test_a_line_needs_support():
    """Twelve of eighteen epochs make a line, nine do not; scattered paths never do."""
    assert found(buffer_of(EPOCH[6:], 0, LENGTH[6:])).anchor == 0
    assert found(buffer_of(EPOCH[9:], 0, LENGTH[9:])) is None
    scattered = np.random.default_rng(1).uniform(0.0, 180.0, 18)
    assert found(buffer_of(EPOCH, 0, scattered)) is None
    assert found(buffer_of(EPOCH, 0, LENGTH), birth_support=19) is None


def test_the_support_is_counted_as_it_is_set():
    """``birth_support`` paths on one line are enough, wherever in the window they are."""
    assert found(buffer_of(EPOCH[8:], 0, LENGTH[8:])) is not None


def test_what_does_not_start_a_wall():
    """Paths that something explains; a line that ended; one faster than the agent; two anchors' halves."""
    assert found(buffer_of(EPOCH, 0, LENGTH, unassociated=False)) is None
    assert found(buffer_of(EPOCH[:15], 0, LENGTH[:15])) is None
    assert found(buffer_of(EPOCH, 0, 60.0 - 3.0 * EPOCH)) is None
    assert found(buffer_of(EPOCH, EPOCH % 2, LENGTH)) is None


def test_paths_that_lost_too_much_make_no_line():
    """A path weaker than any single bounce of its anchor starts no wall; one of unknown power may."""
    heard = buffer_of(EPOCH, 1, LENGTH, 9.5)
    assert found(heard, np.array([20.0, 9.0])) is None
    assert found(heard, np.array([5.0, 10.0])).anchor == 1
    assert found(buffer_of(EPOCH, 1, LENGTH), np.array([5.0, 5.0])) is not None


def test_the_line_takes_its_paths_from_clutter():
    """One path an epoch, those of the wall, in order; bent by the motion too."""
    rng = np.random.default_rng(2)
    length = LENGTH + 0.01 * (EPOCH - 9.0) ** 2 + 0.05 * rng.normal(size=18)
    epoch = np.concatenate([EPOCH, np.repeat(EPOCH, 3)])
    lengths = np.concatenate([length, rng.uniform(20.0, 150.0, 54)])
    line = found(buffer_of(epoch, 0, lengths))
    assert len(line.row) >= 16
    assert np.all(np.diff(line.epoch) > 0)
    true = {round(float(each), 9) for each in length}
    assert sum(round(float(each), 9) in true for each in line.length_m) >= len(line.row) - 1


def test_intervals_overlap_as_counted_one_by_one():
    """The sweep over sorted ends against a count at every begin."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        begin = rng.normal(size=12)
        end = begin + rng.exponential(0.5, 12)
        expected = max(int(np.sum((begin <= at) & (end >= at))) for at in begin)
        most, at = most_overlap(np.sort(begin), np.sort(end))
        assert most == expected
        assert np.sum((begin <= at) & (end >= at)) == expected


@pytest.mark.parametrize("paths", [200])
def test_time_is_bounded_with_many_paths_an_epoch(paths):
    """Two hundred unassociated paths an epoch and anchor, as many as the clutter guard lets through."""
    rng = np.random.default_rng(4)
    epoch = np.repeat(EPOCH, 2 * paths)
    heard = buffer_of(epoch, np.tile([0, 1], len(epoch) // 2), rng.uniform(1.0, 180.0, len(epoch)))
    found(heard)
    begin = time.process_time()
    for _ in range(3):
        found(heard)
    assert time.process_time() - begin < 3.0
