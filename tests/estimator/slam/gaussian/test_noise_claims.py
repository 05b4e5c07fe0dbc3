"""Ranges whose standard deviation is claimed three times too small or too large: whole runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.evaluation.metrics import nees
from estimator.measurements import MeasurementSet
from estimator.slam import run_slam

FALSE_M = 2.5  # farther from every wall than this, a wall is none


def claimed(measured: MeasurementSet, factor: float) -> MeasurementSet:
    """The same lengths with deviations that are off by a factor."""
    epochs = tuple(
        replace(epoch, paths=tuple(replace(own, delay_std_s=factor * own.delay_std_s) for own in epoch.paths))
        for epoch in measured.epochs
    )
    model = dict(measured.settings["measurement_model"])
    model["range_std_m"] *= factor
    return replace(measured, epochs=epochs, settings={**measured.settings, "measurement_model": model})


def outcome(room, method: str, factor: float, seed: int) -> tuple[float, int]:
    """NEES per dimension over a run, and how many walls of its map are none."""
    measured = claimed(room.measure(seed, know_anchors=method == "mva"), factor)
    result = run_slam(measured, method)
    error = result.agent_mean[1:, :2] - (room.track - room.track[0])[1:]
    walls = result.wall_mean_m[-1][result.wall_valid[-1]]
    false = sum(np.linalg.norm(room.vrps - wall, axis=1).min() > FALSE_M for wall in walls)
    return float(nees(error, result.agent_covariance[1:, :2, :2]).mean()), false


@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
def test_a_wrong_claim_is_found_out(room, factor):
    """The covariance stays honest, and noise makes no wall."""
    honest, false = outcome(room, "mva", factor, 60)
    assert 0.5 < honest < 2.0
    assert false == 0


@pytest.mark.soak
@pytest.mark.parametrize("method", ["hybrid", "mva"])
@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
def test_wrong_claims_are_found_out(room, method, factor, record_property):
    """The same over runs, with unknown anchors too."""
    runs = [outcome(room, method, factor, seed) for seed in range(60, 80)]
    record_property("mean NEES per dimension", np.mean([honest for honest, _ in runs]))
    assert 0.5 < np.mean([honest for honest, _ in runs]) < 2.0
    assert sum(false for _, false in runs) == 0
