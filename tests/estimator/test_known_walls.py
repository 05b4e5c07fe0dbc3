"""Walls of a plan as reference points."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.known_walls import known_walls

FROM = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 40.0], [30.0, 40.0], [9.0, 5.0]])
TO = np.array([[0.0, 40.0], [80.0, 0.0], [20.0, 40.0], [80.0, 40.0], [9.0, 30.0]])
START = np.array([9.0, 15.0])


def test_lines_about_the_start(caplog):
    """Pieces of a line are one wall, a wall in line with the start none; the nearest come first."""
    caplog.set_level(logging.INFO, "hapslam")
    walls = known_walls(FROM, TO, START, std_m=0.1)
    np.testing.assert_allclose([wall.mean_m for wall in walls], [[-18.0, 0.0], [0.0, -30.0], [0.0, 50.0]])
    np.testing.assert_allclose(walls[0].covariance_m2, 0.04 * np.eye(2))
    assert "walls in line with the start are left out: 1" in caplog.text
    (nearest,) = known_walls(FROM, TO, START, most=1)
    np.testing.assert_allclose(nearest.mean_m, [-18.0, 0.0])
    assert "of 3 lines of walls the 1 nearest" in caplog.text


def test_the_agents_axes():
    """An agent that looks along y sees the wall on its left that is west in the plan."""
    turned = known_walls(FROM, TO, START, np.pi / 2.0)
    np.testing.assert_allclose(turned[0].mean_m, [0.0, 18.0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"from_m": FROM[:2]}, "expected shapes"),
        ({"start_m": [np.nan, 0.0]}, "finite numbers"),
        ({"std_m": 0.0}, "positive numbers"),
        ({"from_m": FROM[4:], "to_m": TO[4:]}, "do not pass through the start, got 1 walls"),
        ({"from_m": FROM[:0], "to_m": TO[:0]}, "got 0 walls"),
    ],
)
def test_what_is_no_plan_is_told(change, words):
    """Shapes, numbers, and plans without a wall that helps."""
    with pytest.raises(InputError, match=words):
        known_walls(**({"from_m": FROM, "to_m": TO, "start_m": START} | change))
