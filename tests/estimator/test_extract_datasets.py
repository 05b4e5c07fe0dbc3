"""Extraction from small datasets: arrays, snapshots, tails, sweeps on the way, and bad datasets."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from estimator.arrays import BeamSet
from estimator.channel.diffuse import DiffuseConfig
from estimator.channel.model import delay_atoms
from estimator.dataset import Dataset, DatasetWriter, open_dataset
from estimator.errors import ConfigurationError, FileFormatError
from estimator.extract import ExtractConfig, extract, extract_epochs, sense_sweeps
from estimator.measurement_files import load_measurements, save_measurements
from estimator.odometry import Odometry, odometry_variables
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid
from raytrace.plan.files import load_floorplan, updated
from raytrace.propagation.images import image_paths
from raytrace.radio.channel import add_noise, channel_response
from tests.channel_shards import GATE_M, Room, beams_of, echo_shard, passive_shard, signal

GRID = OfdmGrid(28e9, 480e3, 256, comb=4)


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., Dataset]:
    """Makes a small dataset of one path per channel, with changes to its parts."""

    def build(
        manifest: dict[str, Any] | None = None,
        passive: xr.Dataset | None = None,
        echo: xr.Dataset | None = None,
        without: tuple[str, ...] = (),
    ) -> Dataset:
        rng = np.random.default_rng(32)
        cfr = add_noise(1e-4 * delay_atoms(GRID, np.full((2, 1, 3), 1e-7)), 1e-12, rng)
        whole = {
            "anchors": ["a"],
            "epochs": 2,
            "radio": signal(GRID, 1e-12),
            "echo": {**signal(GRID, 1e-12), "beams": beams_of(BeamSet(4, 4, 8))},
        }
        writer = DatasetWriter(tmp_path / "dataset", {**whole, **(manifest or {})})
        if "passive" not in without:
            shard = passive_shard(cfr, ["a"]) if passive is None else passive
            writer.write("passive", "passive-00000.nc", shard)
        if "echo" not in without:
            shard = echo_shard(add_noise(np.zeros((1, 8, GRID.tones)), 1e-12, rng)) if echo is None else echo
            writer.write("echo", "echo-00000.nc", shard)
        writer.finish()
        return open_dataset(tmp_path / "dataset")

    return build


def test_several_antennas_are_welcome(make: Callable[..., Dataset]) -> None:
    """With an array at the agent, delays come from its first antenna."""
    measured = extract(make())
    assert [len(epoch.paths[0]) for epoch in measured.epochs] == [1, 1]
    assert measured.epochs[0].paths[0].delay_s[0] == pytest.approx(1e-7, abs=1e-10)
    assert measured.epochs[0].paths[0].gain_db[0] == pytest.approx(-80.0, abs=0.1)


@pytest.mark.parametrize("rows", [4, 1])
def test_directions_of_an_array_are_measured(tmp_path: Path, rows: int) -> None:
    """Channels of a lying 4 x 4 array give directions that are right and not overclaimed.

    Of a row of four, which cannot tell front from back, no direction is given.
    """
    rng = np.random.default_rng(33)
    changes = {
        "radio.agent_array.elements": 4,
        "radio.agent_array.rows": rows,
        "radio.agent_array.lying": True,
        "radio.subcarriers": 1024,
    }
    plan = updated(load_floorplan("l-room"), changes)
    track = plan.track()[:64:4]
    paths = image_paths(plan, track, depth=1)
    grid, noise = plan.radio.grid(), plan.radio.noise_variance()
    array = plan.radio.agent_array.array()
    heading = plan.heading_rad
    local = np.where(paths.valid, paths.arrival_azimuth_rad - heading, 0.0)
    rise = np.where(paths.valid, paths.arrival_elevation_rad, 0.0)
    response = channel_response(paths, grid, np.swapaxes(array.steering(local, rise), -1, -2))
    cfr = add_noise(response, noise, rng)
    described = {"elements": 4, "rows": rows, "lying": True, "spacing_wavelengths": 0.5, "boresight_rad": 0.0}
    anchors = [anchor.name for anchor in plan.anchors]
    radio = {**signal(grid, noise), "agent_array": described}
    writer = DatasetWriter(tmp_path / "dataset", {"anchors": anchors, "epochs": len(track), "radio": radio})
    writer.write("passive", "passive-00000.nc", passive_shard(cfr, anchors))
    writer.finish()
    measured = extract(open_dataset(tmp_path / "dataset"))
    assert np.mean([len(p) for epoch in measured.epochs for p in epoch.paths]) > 3.0
    if rows == 1:
        assert all(p.azimuth_rad is None for epoch in measured.epochs for p in epoch.paths)
        return
    normalised, errors = [], []
    for t, epoch in enumerate(measured.epochs):
        for k, heard in enumerate(epoch.paths):
            assert heard.azimuth_rad is not None
            assert heard.azimuth_std_rad is not None
            valid = paths.valid[t, k]
            gap = np.abs(heard.range_m[:, None] - SPEED_OF_LIGHT_M_S * paths.delay_s[t, k][valid])
            true = (paths.arrival_azimuth_rad[t, k][valid] - heading)[np.argmin(gap, axis=1)]
            error = np.angle(np.exp(1j * (heard.azimuth_rad - true)))[np.min(gap, axis=1) < GATE_M]
            errors += list(error)
            normalised += list(error / heard.azimuth_std_rad[np.min(gap, axis=1) < GATE_M])
    assert len(errors) > 80
    assert np.mean(np.abs(errors) < np.deg2rad(1.0)) > 0.97
    assert np.mean(np.square(normalised)) < 1.5  # less: the floor claimed is for arrays less ideal than this


def test_snapshots_and_antennas_of_anchors_are_used_together(make: Callable[..., Dataset]) -> None:
    """Eight looks at a path too weak for one: found in every epoch, its gain the mean power."""
    rng = np.random.default_rng(34)
    looks = 1e-4 * np.exp(2j * np.pi * rng.uniform(size=(2, 1, 4, 2, 1, 1))) * delay_atoms(GRID, 1e-7)
    cfr = add_noise(looks, 1e-7, rng)
    dims = ("epoch", "anchor", "snapshot", "anchor_antenna", "antenna", "tone")
    shard = passive_shard(np.zeros((2, 1, 1, GRID.tones)), ["a"]).drop_vars(("cfr_re", "cfr_im"))
    shard = shard.assign(cfr_re=(dims, cfr.real), cfr_im=(dims, cfr.imag))
    measured = extract(make(passive=shard, manifest={"radio": signal(GRID, 1e-7)}))
    for epoch in measured.epochs:
        assert len(epoch.paths[0]) == 1
        assert abs(epoch.paths[0].delay_s[0] - 1e-7) < 4.0 * epoch.paths[0].delay_std_s[0]
        assert epoch.paths[0].gain_db[0] == pytest.approx(-80.0, abs=2.0)


def test_a_diffuse_tail_is_no_crowd_of_paths(make: Callable[..., Dataset]) -> None:
    """A path before a dense tail: with the tail estimated one path is left of many; settings are recorded."""
    rng = np.random.default_rng(35)
    late, channels = np.linspace(0.0, 4e-7, 1600), []
    level = 2e-6 * np.exp(-0.5 * late / 6e-8)
    for _ in range(2):
        gain = level * (rng.normal(size=len(late)) + 1j * rng.normal(size=len(late)))
        channels.append(1e-4 * delay_atoms(GRID, np.array(1e-7)) + gain @ delay_atoms(GRID, 1e-7 + late))
    cfr = add_noise(np.array(channels)[:, None, None], 1e-13, rng)
    dataset = make(passive=passive_shard(cfr, ["a"]), manifest={"radio": signal(GRID, 1e-13)})
    white, tailed = extract(dataset), extract(dataset, ExtractConfig(diffuse=DiffuseConfig()))
    for crowd, alone in zip(white.epochs, tailed.epochs, strict=True):
        assert len(crowd.paths[0]) >= 4
        assert len(alone.paths[0]) <= 2
        nearest = np.min(np.abs(alone.paths[0].delay_s - 1e-7))
        assert nearest < 4.0 * np.min(alone.paths[0].delay_std_s)
    assert tailed.settings["extract"]["diffuse"]["closest_cells"] == 0.5


def test_tails_of_snapshots_are_refused(make: Callable[..., Dataset]) -> None:
    """A tail is estimated of one snapshot; what came is said."""
    dims = ("epoch", "anchor", "snapshot", "antenna", "tone")
    shard = passive_shard(np.zeros((2, 1, 1, GRID.tones)), ["a"]).drop_vars(("cfr_re", "cfr_im"))
    looks = np.ones((2, 1, 3, 1, GRID.tones), dtype=np.float32)
    shard = shard.assign(cfr_re=(dims, looks), cfr_im=(dims, looks))
    with pytest.raises(ConfigurationError, match="expected one snapshot of a channel, got 3"):
        extract(make(passive=shard), ExtractConfig(diffuse=DiffuseConfig()))


def test_a_dataset_without_a_sweep_has_no_walls(make: Callable[..., Dataset]) -> None:
    """Without an echo shard there are epochs and no walls, also where the manifest knows no echo."""
    dataset = make(without=("echo",))
    assert sense_sweeps(dataset) == {}
    assert extract(dataset).walls == ()
    assert len(extract(dataset).epochs) == 2


@pytest.mark.parametrize("loud", [(0, 2), (2,), (0,)])
def test_every_sweep_goes_to_its_epoch(
    room: Room, make: Callable[..., Dataset], tmp_path: Path, loud: tuple[int, ...]
) -> None:
    """The first epoch's sweep gives the walls at the start, later ones belong to their epochs."""
    (sweep,) = room.dataset.shards("echo")
    echo = sweep["echo_re"].values[0] + 1j * sweep["echo_im"].values[0]
    silent = np.zeros_like(echo)
    described = {name: room.dataset.manifest[name] for name in ("echo", "radio")}
    cfr = np.zeros((3, 1, 1, OfdmGrid(28e9, 120e3, 3276, 4).tones), dtype=complex)
    measured = extract(
        make(
            passive=passive_shard(cfr, ["a"]),
            echo=echo_shard(np.stack([echo if epoch in loud else silent for epoch in (0, 2)]), 0, 2),
            manifest={**described, "epochs": 3, "agent": {"max_speed_m_s": 0.75}},
        )
    )
    save_measurements(measured, tmp_path / "m.nc")
    again = load_measurements(tmp_path / "m.nc")
    for kept in (measured, again):
        assert kept.max_speed_m_s == 0.75
        assert len(kept.walls) == (4 if 0 in loud else 0)
        assert [len(epoch.sweep) for epoch in kept.epochs] == [0, 0, 4 if 2 in loud else 0]
    for wall, seen in zip(measured.walls, again.epochs[2].sweep, strict=False):
        np.testing.assert_array_equal(wall.mean_m, seen.mean_m)


def test_odometry_goes_to_its_epoch(make: Callable[..., Dataset]) -> None:
    """What the agent measured of its own motion is carried on, bit by bit; the first epoch has none."""
    told = Odometry([0.5, 0.01], 0.1, 1e-3 * np.eye(3))
    shard = passive_shard(np.zeros((2, 1, 1, GRID.tones), dtype=complex), ["a"])
    first, second = extract_epochs(make(passive=shard.assign(odometry_variables([None, told]))))
    assert first.odometry is None
    assert second.odometry is not None
    assert second.odometry.turn_rad == 0.1
    np.testing.assert_array_equal(second.odometry.displacement_m, told.displacement_m)


def test_a_sweep_without_channels_is_refused(make: Callable[..., Dataset]) -> None:
    """A sweep of an epoch that has no channels would be lost in silence."""
    dataset = make(echo=echo_shard(np.zeros((1, 8, GRID.tones), dtype=complex), 5))
    with pytest.raises(FileFormatError, match="beam sweeps at epochs with channels, got one at epoch 5"):
        extract(dataset)


def test_channels_that_do_not_fit_the_manifest_are_refused(make: Callable[..., Dataset]) -> None:
    """Another number of tones than the manifest says is named, for channels and for echoes."""
    short = passive_shard(np.zeros((2, 1, 1, 50), dtype=complex), ["a"])
    with pytest.raises(FileFormatError, match="expected channels of 1 anchors and 64 tones.* got 1 and 50"):
        extract_epochs(make(passive=short))


def test_echoes_that_do_not_fit_the_manifest_are_refused(make: Callable[..., Dataset]) -> None:
    """Another number of beams than the manifest says is named."""
    with pytest.raises(FileFormatError, match="expected an echo of 8 beams and 64 tones.* got 9 and 64"):
        sense_sweeps(make(echo=echo_shard(np.zeros((1, 9, GRID.tones), dtype=complex))))


def test_missing_parts_are_named(make: Callable[..., Dataset]) -> None:
    """A manifest without channels, and one whose radio lacks an entry, say what is missing."""
    dataset = make(without=("passive",))
    with pytest.raises(FileFormatError, match="expected passive channels, the manifest lists none"):
        extract(dataset)
    radio = {name: value for name, value in dataset.manifest["radio"].items() if name != "comb"}
    broken = Dataset(dataset.path, {**dataset.manifest, "radio": radio})
    with pytest.raises(FileFormatError, match="radio: expected the entry 'comb' in the manifest"):
        extract(broken)
    with pytest.raises(FileFormatError, match="radio: expected a table in the manifest, got 7"):
        extract(Dataset(dataset.path, {**dataset.manifest, "radio": 7}))


@pytest.mark.parametrize("drop", [True, False])
def test_bad_variables_are_named(make: Callable[..., Dataset], drop: bool) -> None:
    """A missing variable and wrong axes are told apart."""
    shard = passive_shard(np.zeros((2, 1, 1, GRID.tones), dtype=complex), ["a"])
    shard = shard.drop_vars("cfr_im") if drop else shard.rename(antenna="element")
    message = "passive: expected the variable .*cfr_im" if drop else "passive: expected cfr with the axes"
    with pytest.raises(FileFormatError, match=message):
        extract_epochs(make(passive=shard))


def test_a_truncated_shard_is_refused_and_left_alone(make: Callable[..., Dataset]) -> None:
    """A shard cut short is named with both sizes, and stays as it is."""
    dataset = make()
    file = dataset.path / "passive-00000.nc"
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    with pytest.raises(FileFormatError, match="truncated or changed"):
        extract(dataset)
    assert file.read_bytes() == whole[:-100]
    assert json.loads((dataset.path / "manifest.json").read_text())["complete"] is True


def test_bad_batches_are_refused() -> None:
    """A batch holds at least one channel."""
    with pytest.raises(ConfigurationError, match="batch: expected at least 1, got 0"):
        ExtractConfig(batch=0)
