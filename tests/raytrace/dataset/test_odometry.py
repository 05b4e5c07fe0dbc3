"""Odometry of a dataset against the true track: without noise a dead reckoning, with noise its statistics."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from estimator.geometry import rotate
from estimator.odometry import Odometry, odometry_of
from raytrace.dataset.odometry import with_odometry
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan

EPOCHS = 60


def measured(plan: FloorPlan, seed: int, first: int = 0) -> list[Odometry | None]:
    """Odometry of a shard of all epochs from ``first`` on."""
    shard = xr.Dataset(coords={"epoch": np.arange(first, plan.agent.epochs)})
    return odometry_of(with_odometry(shard, plan, np.random.default_rng(seed)))


def plan_with(**noise: float) -> FloorPlan:
    """The office's walk, which turns by more than 90 degrees, with these errors."""
    return updated(load_floorplan("office"), {"agent.epochs": EPOCHS, "agent.odometry": noise})


@pytest.mark.parametrize("orientation", ["fixed", "travel"])
def test_without_noise_it_is_the_track(orientation: str) -> None:
    """Dead reckoning from the estimator's x axis gives the true track in the estimator's frame."""
    plan = updated(
        plan_with(displacement_std_share=0.0, turn_std_rad=0.0),
        {"agent.orientation": orientation, "agent.heading_deg": 30.0},
    )
    track = rotate(plan.track()[:, :2] - plan.track()[0, :2], -plan.heading_rad)
    first, *others = measured(plan, 1)
    assert first is None
    place, heading = np.zeros(2), 0.0
    for told, true in zip(others, track[1:], strict=True):
        assert told is not None
        place = place + rotate(told.displacement_m, heading)
        heading += told.turn_rad
        np.testing.assert_allclose(place, true, atol=1e-9)
    assert heading == pytest.approx(plan.body_azimuths_rad()[-1] - plan.heading_rad)


def test_noise_is_that_of_the_plan() -> None:
    """Over ten walks errors have the stated standard deviations, within four of their own."""
    exact = measured(plan_with(displacement_std_share=0.0, turn_std_rad=0.0), 1)[1:]
    ways, turns = [], []
    for seed in range(10):
        noisy = measured(plan_with(displacement_std_share=0.05, turn_std_rad=0.0175), seed)[1:]
        for told, true in zip(noisy, exact, strict=True):
            assert told is not None
            assert true is not None
            error = told.displacement_m - true.displacement_m
            ways.extend(error / np.linalg.norm(true.displacement_m))
            turns.append(told.turn_rad - true.turn_rad)
            std = 0.05 * np.linalg.norm(told.displacement_m)
            np.testing.assert_allclose(told.covariance, np.diag([std**2, std**2, 0.0175**2]))
    assert np.std(ways) == pytest.approx(0.05, abs=4 * 0.05 / np.sqrt(2 * len(ways)))
    assert np.std(turns) == pytest.approx(0.0175, abs=4 * 0.0175 / np.sqrt(2 * len(turns)))


def test_a_step_is_the_same_wherever_the_track_is_cut() -> None:
    """A later shard, or a longer walk, draws the same noise for the same step."""
    whole, tail = measured(plan_with(turn_std_rad=0.02), 3), measured(plan_with(turn_std_rad=0.02), 3, 40)
    longer = measured(updated(plan_with(turn_std_rad=0.02), {"agent.epochs": EPOCHS + 5}), 3)
    for one, other in [*zip(whole[40:], tail, strict=True), *zip(whole[1:], longer[1:], strict=False)]:
        assert one is not None
        assert other is not None
        assert one.turn_rad == other.turn_rad
        np.testing.assert_array_equal(one.displacement_m, other.displacement_m)


def test_without_the_table_there_is_none() -> None:
    """A plan that says nothing of odometry makes the shard that it always made."""
    plan = updated(load_floorplan("office"), {"agent.epochs": EPOCHS})
    shard = xr.Dataset(coords={"epoch": np.arange(EPOCHS)})
    assert with_odometry(shard, plan, np.random.default_rng(1)) is shard
