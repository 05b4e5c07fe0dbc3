"""From channels to measurements: acceptance figures on the L-shaped room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from estimator.channel.nomp import NompConfig
from estimator.extract import extract, extract_epochs
from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import Epoch, MeasurementSet
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.propagation.paths import PathSet
from tests.channel_shards import GATE_M, Room


@pytest.fixture(scope="module")
def measured(room: Room) -> MeasurementSet:
    return extract(room.dataset)


@dataclass(frozen=True)
class Matched:
    """How detections and true paths pair up, over all channels."""

    errors: dict[int, np.ndarray]
    normalised: dict[int, np.ndarray]
    true: dict[int, int]
    unexplained: float
    without_path: float


def match(epochs: Sequence[Epoch], paths: PathSet) -> Matched:
    """Pair detections with paths, of low order first, within half a metre."""
    errors: dict[int, list[float]] = {0: [], 1: [], 2: []}
    normalised: dict[int, list[float]] = {0: [], 1: [], 2: []}
    true = dict.fromkeys(errors, 0)
    unexplained = without = channels = 0
    for t, epoch in enumerate(epochs):
        for k, heard in enumerate(epoch.paths):
            channels += 1
            valid = paths.valid[t, k]
            length, order = paths.delay_s[t, k][valid] * SPEED_OF_LIGHT_M_S, paths.order[t, k][valid]
            free = np.ones(len(heard), dtype=bool)
            for q in errors:
                wanted = length[order == q]
                true[q] += len(wanted)
                gap = np.abs(heard.range_m[:, None] - wanted)
                gap[~free] = np.inf
                for i, j in zip(*linear_sum_assignment(np.minimum(gap, GATE_M)), strict=True):
                    if gap[i, j] < GATE_M:
                        free[i] = False
                        errors[q].append(heard.range_m[i] - wanted[j])
                        normalised[q].append(errors[q][-1] / heard.range_std_m[i])
            unexplained += int(np.sum(free))
            nearest = np.min(np.abs(heard.range_m[:, None] - length), axis=1)
            without += int(np.sum(nearest > GATE_M))
    unexplained += len(errors[2])  # second-order paths are explained by nothing that is known at first
    return Matched(
        {q: np.array(e) for q, e in errors.items()},
        {q: np.array(e) for q, e in normalised.items()},
        true,
        unexplained / channels,
        without / channels,
    )


def test_delays_of_the_l_room(room: Room, measured: MeasurementSet) -> None:
    """Detection, accuracy, clutter and honest deviations of delays in a room of six concrete walls."""
    found = match(measured.epochs, room.paths)
    assert found.true[0] > 70
    assert found.true[1] > 250
    assert len(found.errors[0]) >= 0.99 * found.true[0]
    assert len(found.errors[1]) >= 0.95 * found.true[1]
    for order in (0, 1):
        error = found.errors[order]
        assert 1.4826 * np.median(np.abs(error - np.median(error))) <= 0.05
        assert np.std(error) <= 0.05
        assert np.mean(np.abs(error) < 0.3) >= 0.99
        assert 0.3 < np.mean(found.normalised[order] ** 2) < 2.0
    assert found.unexplained <= 9.0
    assert found.without_path <= 0.2


def test_walls_of_the_l_room(room: Room, measured: MeasurementSet) -> None:
    """The four walls in sight of the start are sensed, each within 4 sigma and 0.4 m, and no other."""
    assert len(measured.walls) == 4
    for wall in measured.walls:
        error = wall.mean_m - room.vrps_m[np.argmin(np.linalg.norm(room.vrps_m - wall.mean_m, axis=1))]
        assert np.linalg.norm(error) < 0.4
        assert error @ np.linalg.solve(wall.covariance_m2, error) < 16.0


def test_gains_are_those_of_the_paths(room: Room, measured: MeasurementSet) -> None:
    """The gain of the line of sight is the free-space one, in dB."""
    for t, k in ((0, 0), (20, 1)):
        paths = measured.epochs[t].paths[k]
        strongest = int(np.argmax(paths.gain_db))
        truth = np.max(20.0 * np.log10(np.abs(room.paths.amplitude[t, k]).clip(1e-12)))
        assert paths.gain_db[strongest] == pytest.approx(truth, abs=0.2)


def test_epochs_anchors_and_settings_are_recorded(
    room: Room, measured: MeasurementSet, tmp_path: Path
) -> None:
    """Shards follow each other, names and times are kept, and the settings survive the file."""
    assert measured.anchors == ("pa1", "pa2")
    assert [epoch.index for epoch in measured.epochs] == list(range(len(room.paths.delay_s)))
    assert measured.epochs[3].time_s == 1.5
    assert measured.carrier_hz == 28e9
    assert measured.dataset is None
    save_measurements(measured, tmp_path / "m.nc")
    settings = load_measurements(tmp_path / "m.nc").settings
    assert settings["seed"] == 31
    assert settings["extract"]["nomp"]["dynamic_range_db"] == 30.0
    assert settings["extract"]["flash"]["pursuit"]["max_range_m"] == 150.0


def test_same_dataset_gives_the_same_bytes(room: Room, measured: MeasurementSet, tmp_path: Path) -> None:
    """Extracting twice writes the same file twice."""
    save_measurements(measured, tmp_path / "a.nc")
    save_measurements(extract(room.dataset), tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_progress_reaches_the_end(room: Room) -> None:
    """Progress counts channels, never goes back, and ends at all of them."""
    seen: list[tuple[int, int]] = []
    config = NompConfig(max_paths=1)
    extract_epochs(
        room.dataset, config, batch=30, progress=lambda done, total, text: seen.append((done, total))
    )
    total = 2 * len(room.paths.delay_s)
    assert seen[-1] == (total, total)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert all(entry[1] == total for entry in seen)
