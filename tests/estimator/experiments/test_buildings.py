"""Buildings: figures counted by hand, and prepared buildings mapped, the short form of the long test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.errors import InputError
from estimator.experiments.building_limits import building_scenario, position_limit, sensing_of
from estimator.experiments.building_runs import SENSING, BuildingRun, BuildingScore, Sketch, map_building
from estimator.experiments.buildings import report_of, summary_of
from estimator.experiments.report import write_report
from estimator.measurement_files import load_measurements
from estimator.measurements import MeasurementSet
from estimator.slam.run import run_slam

HERE = Path(__file__).parent / "buildings"
KINDS = ("suite", "aisles", "shops")


def a_score(error: float, **changes: Any) -> BuildingScore:
    """A run of four epochs with a constant error."""
    fields: dict[str, Any] = {
        "error_m": np.full(4, error),
        "lost": error > 1.0,
        "flagged": np.zeros(4, dtype=bool),
        "protected": np.ones(4, dtype=bool),
        "nees": 1.0,
        "anchors_error_m": np.array([0.1, 0.5]),
        "walls_due": 4,
        "walls_found": 3,
        "walls_false": 1,
        "seconds": np.array([0.001, 0.002, 0.003, 0.1]),
    }
    return BuildingScore(**{**fields, **changes})


def a_run(kind: str, number: int, error: float, **changes: Any) -> BuildingRun:
    """A building whose halves have errors of 0.2 and 0.4 m."""
    sketch = Sketch(np.array([[[0.0, 0.0], [4.0, 0.0]]]), np.eye(2), np.eye(2), (np.eye(2),))
    scores = dict(zip(SENSING, (a_score(error, **changes), a_score(0.2), a_score(0.4)), strict=True))
    return BuildingRun(kind, number, scores, sketch, np.full(4, 0.05))


def runs() -> list[BuildingRun]:
    """A good run, one lost and flagged, one lost in silence, one good and flagged, one refused."""
    flag = np.array([False, False, True, True])
    refused = BuildingRun("shops", 1, dict.fromkeys(SENSING), None, np.full(4, 0.07))
    return [
        a_run("suite", 0, 0.1),
        a_run("suite", 1, 3.0, flagged=flag, protected=np.array([True, False, False, False])),
        a_run("suite", 2, 2.0, protected=np.zeros(4, dtype=bool)),
        a_run("shops", 0, 0.3, flagged=flag),
        refused,
    ]


def test_figures_are_those_counted_by_hand() -> None:
    """Lost, silent and flagged runs, shares over all anchors, walls and epochs, by kind and in all."""
    summary = summary_of(runs())
    assert list(summary) == ["suite", "shops", "all"]
    every = summary["all"]
    assert [every[name] for name in ("runs", "refused", "lost", "silent", "flagged_good")] == [5, 1, 2, 1, 1]
    assert every["mae_median_m"] == pytest.approx((0.3 + 2.0) / 2)
    assert every["anchors_within_0_3_m"] == 0.5
    assert every["walls_found"] == 0.75
    assert every["walls_false_per_run"] == 1.0
    assert every["protection_held"] == pytest.approx((4 + 1 + 0 + 2) / (4 + 2 + 4 + 2))
    assert every["seconds_per_epoch_median"] == pytest.approx(0.0025)
    assert every["seconds_per_epoch_max"] == pytest.approx(0.1)
    assert every["mae_ratio_median"] == pytest.approx((0.3 / 0.2 + 2.0 / 0.2) / 2)
    assert summary["shops"]["limit_median_m"] == pytest.approx(0.06)
    assert every["echo_only"]["mae_median_m"] == pytest.approx(0.2)
    assert every["passive_only"]["lost"] == 0
    assert summary["suite"]["silent"] == 1
    assert summary["shops"]["mae_median_m"] == pytest.approx(0.3)


def test_a_report_has_a_picture_and_figures(tmp_path: Path) -> None:
    """Numbers, text and picture are written; runs that were refused are in the figures and not drawn."""
    write_report(report_of(runs(), {"seed": 1}), tmp_path)
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".svg", ".json", ".txt"}
    assert "shops (2), echoes alone" in (tmp_path / "buildings.txt").read_text(encoding="utf-8")
    drawn = (tmp_path / "buildings.svg").read_text(encoding="utf-8")
    assert drawn.count("<svg") == 1


def measured(kind: str, sweep_every: int, odometry: bool) -> tuple[MeasurementSet, xr.Dataset]:
    """A prepared building with a sweep at every so many epochs, with odometry or without."""
    whole = load_measurements(HERE / f"{kind}-measured.nc")
    epochs = tuple(
        replace(
            epoch,
            sweep=epoch.sweep if sweep_every and epoch.index % sweep_every == 0 else (),
            odometry=epoch.odometry if odometry else None,
        )
        for epoch in whole.epochs
    )
    with xr.open_dataset(HERE / f"{kind}-truth.nc", engine="h5netcdf") as truth:
        return replace(whole, epochs=epochs), truth.load()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("sweep_every", "odometry"), [(2, False), (10, True)])
def test_prepared_buildings_are_mapped(kind: str, sweep_every: int, odometry: bool) -> None:
    """With sweeps at every second epoch, or at every tenth and odometry, none is lost."""
    run = map_building(kind, 0, *measured(kind, sweep_every, odometry), seed=1)
    score = run.scores["hybrid"]
    assert score is not None
    assert not score.lost
    assert score.mae_m < 0.15
    assert 0.0 < run.limit_m[1:].mean() < 0.15
    assert score.walls_false == 0


@pytest.mark.parametrize("kind", KINDS)
def test_limits_fall_with_what_is_sensed(kind: str) -> None:
    """Sweeps at every second epoch and odometry tell more than sweeps alone, these more than one sweep."""
    rich, plain, once = (
        position_limit(*measured(kind, every, odometry)).mean()
        for every, odometry in ((2, True), (2, False), (0, False))
    )
    assert 0.0 < rich < plain < once


def test_sensing_is_what_the_measurements_state() -> None:
    """Odometry of 5 % and 0.0175 rad, a sweep at every tenth epoch, no angles; heights are the building's."""
    given, truth = measured("suite", 10, True)
    scenario = building_scenario(truth)
    sensing = sensing_of(given, scenario)
    assert sensing.odometry == pytest.approx((0.05, 0.0175))
    assert (sensing.sweep_every, sensing.azimuth_std_rad) == (10, None)
    assert scenario.height2_m2 is not None
    above = truth["anchor_position_m"].values[:, 2] - 1.5
    np.testing.assert_allclose(scenario.height2_m2, above**2)


@pytest.mark.parametrize("kind", KINDS)
def test_one_sweep_is_not_lost_in_silence(kind: str) -> None:
    """With the sweep at the start alone a building may be lost, and then says so."""
    run = map_building(kind, 0, *measured(kind, 0, False), seed=1)
    score = run.scores["hybrid"]
    assert score is not None
    assert not score.silent


def test_an_agent_put_elsewhere_is_flagged_and_found_again() -> None:
    """Unannounced, in a building that it has mapped: within three sweeps, and the run says so."""
    measured = load_measurements(HERE / "shops-measured.nc")
    with xr.open_dataset(HERE / "shops-truth.nc") as truth:
        track = truth["track_m"].values[:, :2] - truth["track_m"].values[0, :2]
    middle, step_s = len(track) // 2, measured.epochs[1].time_s - measured.epochs[0].time_s
    order = [*range(middle), *range(middle // 3, middle // 3 + 8)]
    epochs = tuple(
        replace(measured.epochs[one], index=number, time_s=measured.epochs[0].time_s + number * step_s)
        for number, one in enumerate(order)
    )
    result = run_slam(replace(measured, epochs=epochs))
    error = np.linalg.norm(result.agent_mean[:, :2] - track[order], axis=1)
    assert np.linalg.norm(track[order[middle]] - track[order[middle - 1]]) > 2.0
    assert error[:middle].max() < 0.5
    assert error[middle + 2 :].max() < 0.5
    assert not result.flagged[:middle].any()
    assert result.flagged[middle : middle + 5].any()


def test_no_wall_at_the_start_is_no_refusal() -> None:
    """The first sweep on the way begins the map; the track before it is what the motion model says."""
    measured = load_measurements(HERE / "shops-measured.nc")
    with xr.open_dataset(HERE / "shops-truth.nc") as truth:
        track = truth["track_m"].values[:30, :2] - truth["track_m"].values[0, :2]
    result = run_slam(replace(measured, walls=(), epochs=measured.epochs[:30]))
    error = np.linalg.norm(result.agent_mean[:, :2] - track, axis=1)
    assert error.mean() < 0.3
    assert result.wall_valid[-1].sum() >= 3
    silent = tuple(replace(epoch, sweep=()) for epoch in measured.epochs[:3])
    with pytest.raises(InputError, match="sensed at the start, sweeps, or known anchors"):
        run_slam(replace(measured, walls=(), epochs=silent))
