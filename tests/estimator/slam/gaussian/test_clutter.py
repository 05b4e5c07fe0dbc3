"""Clutter: the intensity of unassociated paths, learnt from recent epochs."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.gaussian.clutter import Clutter, clutter_density
from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.path_buffer import PathBuffer, Track

NOISE = MeasurementNoise(clutter_mean=2.0, region_m=100.0)


def buffer_of(epochs, first, second):
    """So many unassociated paths an epoch of two anchors, and one associated."""
    anchor = np.tile(np.repeat([0, 1, 0], [first, second, 1]), epochs)
    count = anchor.size
    unassociated = np.tile(np.repeat([True, True, False], [first, second, 1]), epochs)
    some = np.ones(count)
    track = Track(np.arange(epochs), np.zeros((epochs, 2)), np.ones(epochs))
    return PathBuffer(
        track, np.repeat(np.arange(epochs), first + second + 1), anchor, some, some, some, unassociated
    )


def test_before_the_first_epoch_it_is_what_is_expected():
    """And more while no wall is known: most paths must not be taken for the line of sight."""
    empty = PathBuffer.empty()
    assert clutter_density(empty, 2, False, NOISE, Clutter()) == pytest.approx([0.02, 0.02])
    assert clutter_density(empty, 2, True, NOISE, Clutter()) == pytest.approx([0.08, 0.08])


def test_it_follows_what_is_heard_of_each_anchor():
    """A weighted mean of the expectation and of the count, never below the expectation."""
    density = clutter_density(buffer_of(16, 7, 0), 2, False, NOISE, Clutter(prior_epochs=4.0))
    assert density == pytest.approx([(16 * 7 + 4 * 2) / 20 / 100, 0.02])
