"""Runs that know the walls of a floor plan, with known anchors and without."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.known_walls import known_walls
from estimator.measurements import MeasurementSet
from estimator.slam import run_slam


@pytest.fixture
def plan(room):
    """The room's walls from its plan."""
    return known_walls(room.walls[:, 0], room.walls[:, 1], room.track[0])


def error_m(room, measured: MeasurementSet, method: str, walls, engine: str = "gaussian") -> float:
    """Mean error of the position, metres."""
    result = run_slam(measured, method, engine, walls=walls)
    return float(
        np.linalg.norm(
            result.agent_mean[:, :2] - (room.track - room.track[0])[: len(result.epoch)], axis=1
        ).mean()
    )


def test_known_walls_hold_the_map(room, plan):
    """Unknown anchors, walls of the plan: a third of the error that sensed walls leave, or less."""
    measured = room.measure(60, 120)
    known, sensed = (error_m(room, measured, "hybrid", walls) for walls in (plan, None))
    assert known < 0.12
    assert known < 0.5 * sensed


def test_known_walls_and_known_anchors_together(room, plan):
    """Both at once, in hybrid and mva: no worse than anchors alone."""
    measured = room.measure(61, 120, know_anchors=True)
    alone = error_m(room, measured, "mva", None)
    for method in ("hybrid", "mva"):
        assert error_m(room, measured, method, plan) < alone + 0.01


def test_virtual_anchors_refuse_walls(room, plan):
    """A method whose features are no walls says who takes them, in either engine."""
    for method, engine in (("va", "gaussian"), ("va", "particle"), ("passive", "particle")):
        with pytest.raises(InputError, match="hybrid, mva, active take them"):
            run_slam(room.measure(1, 3, know_anchors=True), method, engine, walls=plan)
