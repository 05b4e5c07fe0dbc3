"""The whole chain on ray-traced rooms, at full length: materials, depths, anchors, paths, and no EIRP."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimator.dataset import open_dataset
from estimator.evaluation.comparison import evaluate
from estimator.extract import extract
from estimator.measurements import MeasurementSet
from estimator.slam import run_slam
from raytrace.dataset.generate import generate
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan

SEEDS = (1, 2, 3)
OTHER_ANCHORS = {"right": ((75.0, 5.0), (65.0, 55.0)), "below": ((20.0, 36.0), (55.0, 5.0))}
OTHER_PATHS = {
    "zigzag": [[12, 30], [30, 12], [60, 20], [76, 8], [60, 34], [70, 50], [56, 56], [74, 44]],
    "back": [[60, 55], [72, 40], [66, 20], [40, 25], [10, 33], [14, 8], [45, 8], [60, 14]],
}
UNKNOWN_GAIN_DB = (17.0, -9.0)  # of the two anchors


def of_material(name: str) -> FloorPlan:
    """The L-shaped room, its walls of another material."""
    plan = load_floorplan("l-room")
    walls = tuple(wall.model_copy(update={"material": name}) for wall in plan.walls)
    return plan.model_copy(update={"walls": walls})


def with_anchors(name: str) -> FloorPlan:
    """The L-shaped room with its two anchors elsewhere."""
    plan = load_floorplan("l-room")
    moved = tuple(
        anchor.model_copy(update={"position_m": (*place, anchor.position_m[2])})
        for anchor, place in zip(plan.anchors, OTHER_ANCHORS[name], strict=True)
    )
    return plan.model_copy(update={"anchors": moved})


CASES = {
    "l-room": lambda: load_floorplan("l-room"),
    "glass": lambda: of_material("glass"),
    "plasterboard": lambda: of_material("plasterboard"),
    "depth 3": lambda: updated(load_floorplan("l-room"), {"tracing.depth": 3}),
    "depth 3, glass": lambda: updated(of_material("glass"), {"tracing.depth": 3}),
    "anchors right": lambda: with_anchors("right"),
    "anchors below": lambda: with_anchors("below"),
    "zigzag": lambda: updated(load_floorplan("l-room"), {"agent.waypoints_m": OTHER_PATHS["zigzag"]}),
    "back": lambda: updated(load_floorplan("l-room"), {"agent.waypoints_m": OTHER_PATHS["back"]}),
    "l-room-hard": lambda: load_floorplan("l-room-hard"),
}


def without_eirp(measured: MeasurementSet, powers: bool) -> MeasurementSet:
    """The measurements with gains off by what nobody knows, or without any."""
    epochs = tuple(
        replace(
            epoch,
            paths=tuple(
                replace(paths, gain_db=paths.gain_db + gain if powers else None)
                for paths, gain in zip(epoch.paths, UNKNOWN_GAIN_DB, strict=True)
            ),
        )
        for epoch in measured.epochs
    )
    model = {"measurement_model": {"gain_offset_std_db": 30.0}}
    return replace(measured, epochs=epochs, settings=dict(measured.settings) | model)


@pytest.mark.soak
@pytest.mark.parametrize("case", CASES)
def test_rooms_are_mapped_without_retuning(tmp_path: Path, case: str) -> None:
    """MAE at most 0.2 m (0.25 m in the hard room) and at most one false wall, with the EIRP and without."""
    plan, nees = CASES[case](), []
    for seed in SEEDS:
        generate(plan, tmp_path / str(seed), seed)
        dataset = open_dataset(tmp_path / str(seed))
        measured = extract(dataset)
        told = [measured, without_eirp(measured, powers=True)]
        if case == "l-room":
            told.append(without_eirp(measured, powers=False))
        for kind, given in enumerate(told):
            numbers = evaluate(run_slam(given, seed=seed), dataset.truth())
            assert not numbers["lost"]
            assert numbers["position_mae_m"] <= (0.25 if case == "l-room-hard" else 0.2)
            assert numbers["walls_false"] <= 1
            if kind == 0:
                nees.append(numbers["nees_position_per_dim"])
                assert max(numbers["anchors_error_m"]) <= 0.2
                assert numbers["walls_found"] == numbers["walls_true"]
                assert case != "l-room" or numbers["derotated_rmse_m"] <= 0.05
                assert case != "l-room" or numbers["walls_false"] == 0
    assert np.mean(nees) <= 1.6
