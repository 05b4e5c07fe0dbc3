"""Columns are found by their shadows, where they are; where nothing hides, nothing is found."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.twin.boxes import crosses_box
from estimator.twin.build import build_twin
from estimator.twin.obstacles import ShadowSearch
from raytrace.plan.files import load_floorplan
from tests.mapped_runs import mapped_run

OUTER = ["south", "east", "north", "west"]


@pytest.fixture(scope="module")
def hall():
    """The hall with eight columns, of which the outer walls alone were mapped."""
    plan = load_floorplan("hall")
    result, measurements = mapped_run(plan, np.random.default_rng(1), 1, OUTER)
    return plan, build_twin(result, measurements)


def test_columns_are_found(hall):
    """Eight boxes, within a few centimetres of the columns, and nothing else."""
    plan, twin = hall
    true = np.array([[x, y] for x in (8.0, 16.0, 24.0, 32.0) for y in (8.0, 17.0)])
    boxes = np.array([o.corners_m for o in twin.obstacles]) + plan.track()[0, :2]
    assert len(boxes) == 8
    centres = boxes.mean(axis=1)
    nearest = np.linalg.norm(centres[:, None] - true, axis=-1).argmin(axis=1)
    assert sorted(nearest) == list(range(8))
    assert np.linalg.norm(centres - true[nearest], axis=1).max() < 0.2
    sizes = boxes.max(axis=1) - boxes.min(axis=1)
    assert np.abs(sizes - 0.6).max() < 0.3
    assert min(o.existence for o in twin.obstacles) > 0.95


def test_a_room_without_obstacles_has_none():
    """A few paths missed at random cast no shadow."""
    plan = load_floorplan("l-room")
    result, measurements = mapped_run(plan, np.random.default_rng(2), 2)
    assert build_twin(result, measurements).obstacles == ()


def test_legs_cross_boxes_or_not():
    """Through it, past it, ending before it, inside it, along an axis."""
    box = np.array([1.0, 1.0, 2.0, 2.0])
    legs = [
        ([0, 0], [3, 3], True),
        ([0, 1.5], [3, 1.5], True),
        ([0, 2.5], [3, 2.5], False),
        ([0, 0], [0.9, 0.9], False),
        ([1.2, 1.2], [1.8, 1.5], True),
        ([1.5, 0], [1.5, 0.5], False),
        ([0, 3], [3, 2.2], False),
    ]
    ends = np.array([[a, b] for a, b, _ in legs], dtype=float)
    np.testing.assert_array_equal(crosses_box(ends, box), [crossed for _, _, crossed in legs])


def test_searches_that_cannot_be_are_refused():
    """Cells have a size."""
    with pytest.raises(ConfigurationError, match="cell_m: expected a positive number, got 0"):
        ShadowSearch(cell_m=0)
