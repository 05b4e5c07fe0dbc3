"""The smoothed track against a brute-force moving average."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from raytrace.plan.trajectory import smoothed_track

CORNER = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])


def test_straight_track_is_exact() -> None:
    """Averaging a straight line changes nothing."""
    track = smoothed_track([[1.0, 2.0], [4.0, 6.0]], 2.0, 0.5, 11)
    expected = np.array([1.0, 2.0]) + np.arange(11)[:, None] * 0.5 * np.array([0.6, 0.8])
    np.testing.assert_allclose(track, expected, atol=1e-9)


def test_corner_is_the_mean_of_a_window() -> None:
    """Every position is the mean of the polyline over 5 m, computed here by brute force."""
    arc = np.linspace(0.0, 20.0, 20_001)
    line = np.column_stack([np.minimum(arc, 10.0), np.maximum(arc - 10.0, 0.0)])
    track = smoothed_track(CORNER, 5.0, 0.25, 70)
    means = []
    for centre in np.arange(2.5, 17.5, 0.01):
        window = (arc >= centre - 2.5) & (arc <= centre + 2.5)
        means.append(line[window].mean(axis=0))
    means = np.array(means)
    middle = track[(track[:, 0] > 4.0) & (track[:, 1] < 6.0)]
    distance = np.linalg.norm(middle[:, None] - means[None], axis=-1).min(axis=1)
    assert distance.max() < 6e-3  # half the spacing of the brute-force means


def test_track_starts_at_the_first_waypoint_and_has_equal_steps() -> None:
    """The window shrinks at the start, and the steps are equal along the curve."""
    track = smoothed_track(CORNER, 5.0, 0.5, 36)
    np.testing.assert_allclose(track[0], [0.0, 0.0], atol=1e-12)
    steps = np.linalg.norm(np.diff(track, axis=0), axis=1)
    assert steps.max() <= 0.5 + 1e-6
    assert steps.min() > 0.495  # chords across the corner


def test_no_smoothing_keeps_the_corner() -> None:
    """With a window of zero the polyline itself is sampled."""
    track = smoothed_track(CORNER, 0.0, 1.0, 21)
    np.testing.assert_allclose(track[10], [10.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(track[-1], [10.0, 10.0], atol=2e-3)


def test_too_many_steps() -> None:
    """A track shorter than asked for is an error that says how many positions fit."""
    with pytest.raises(
        InputError, match=r"expected at most 21 positions 1 m apart on a track of 20\.00 m, got 22"
    ):
        smoothed_track(CORNER, 0.0, 1.0, 22)
