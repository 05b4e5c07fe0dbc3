"""Paths over lines without ends, against the image method over walls with ends."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.geometry import vrp_of_line
from estimator.specular import specular_paths
from estimator.twin.unfolding import crossing_points, line_frames, unfold

START = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 7.0], [0.0, 7.0], [5.0, 3.0]])
END = np.array([[12.0, 0.0], [12.0, 7.0], [0.0, 7.0], [0.0, 0.0], [6.5, 4.0]])  # a room with a screen
ANCHORS = np.array([[2.0, 5.0], [10.5, 1.5]])


def test_ends_decide_what_is_visible():
    """With the ends of the walls, unfolded paths are those of the image method, lengths included."""
    rng = np.random.default_rng(1)
    track = rng.uniform([0.5, 0.5], [11.5, 6.5], (40, 2))
    origin = track[0]
    vrps = vrp_of_line(START, END, origin) - origin
    paths = unfold(vrps, ANCHORS - origin, track - origin)
    foot, tangent, _ = line_frames(vrps)
    ends = np.sort(
        np.stack([np.sum((p - origin - foot) * tangent, axis=1) for p in (START, END)], axis=1), axis=1
    )
    low, high = ends[:, 0], ends[:, 1]
    wall = np.maximum(paths.walls, 0)
    on = (paths.bounce_m >= low[wall]) & (paths.bounce_m <= high[wall]) | (paths.walls < 0)
    through = (paths.crossing_m > low) & (paths.crossing_m < high)
    visible = paths.possible & on.all(axis=-1) & ~through.any(axis=(-1, -2))
    true = specular_paths(START, END, ANCHORS, track, order=2)
    for f, sequence in enumerate(true.walls):
        mine = [i for i, walls in enumerate(paths.walls) if tuple(w for w in walls if w >= 0) == sequence]
        np.testing.assert_array_equal(visible[:, :, mine[0]], true.visible[:, :, f], err_msg=str(sequence))
        seen = true.visible[:, :, f]
        np.testing.assert_allclose(paths.length_m[:, :, mine[0]][seen], true.length_m[:, :, f][seen])


def test_lines_meet_where_they_should():
    """Corners of a rectangle; parallels never meet."""
    vrps = np.array([[2.0, 0.0], [0.0, 6.0], [-4.0, 0.0]])
    meets = crossing_points(vrps)
    foot, tangent, _ = line_frames(vrps)
    np.testing.assert_allclose(foot[0] + meets[0, 1] * tangent[0], [1.0, 3.0])
    np.testing.assert_allclose(foot[1] + meets[1, 2] * tangent[1], [-2.0, 3.0])
    assert np.isnan(meets[0, 2])


def test_a_table_that_does_not_fit_is_refused():
    """Sixty walls along a thousand positions would need gigabytes."""
    vrps = np.random.default_rng(1).normal(size=(60, 2))
    with pytest.raises(InputError, match="expected at most"):
        unfold(vrps, np.zeros((4, 2)), np.zeros((1000, 2)))
