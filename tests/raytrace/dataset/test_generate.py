"""Datasets: layout, repeatability bit for bit, and what is refused."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from estimator.dataset import open_dataset
from estimator.errors import ConfigurationError, FileFormatError, OutputExistsError
from estimator.geometry import mirror_in_wall
from raytrace.dataset.generate import Generated, generate
from raytrace.plan.files import load_floorplan, parse_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.images import image_paths

ROOT = Path(__file__).resolve().parents[3]


IDEAL = {
    "radio.timing_jitter_s": 0.0,
    "echo.gain_error_db": 0.0,
    "echo.phase_error_deg": 0.0,
    "echo.range_error_m": 0.0,
}


@pytest.fixture(scope="module")
def plan() -> FloorPlan:
    short = {"agent.epochs": 6, "radio.agent_array.elements": 2, "tracing.engine": "images"}
    return updated(load_floorplan("l-room"), {**short, **IDEAL})


@pytest.fixture(scope="module")
def made(plan: FloorPlan, tmp_path_factory: pytest.TempPathFactory) -> Generated:
    return generate(plan, tmp_path_factory.mktemp("data") / "one", seed=1)


def digests(folder: Path) -> dict[str, str]:
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}


def test_layout(made: Generated, plan: FloorPlan) -> None:
    """The shards, their dimensions, types and units are those agreed for a dataset."""
    dataset = open_dataset(made.dataset.path)
    assert [entry["kind"] for entry in dataset.manifest["shards"]] == ["passive", "echo", "paths", "truth"]
    (passive,), (echo,), (paths,) = (list(dataset.shards(kind)) for kind in ("passive", "echo", "paths"))
    truth = dataset.truth()
    assert passive["cfr_re"].dims == ("epoch", "anchor", "antenna", "tone")
    assert passive["cfr_re"].shape == (6, 2, 2, 819)
    assert passive["cfr_re"].dtype == passive["cfr_im"].dtype == np.float32
    assert echo["echo_re"].shape == (1, 64, 819)
    assert echo["sweep_epoch"].values.tolist() == [0]
    assert paths["delay_s"].dims == ("epoch", "anchor", "path")
    assert paths["walls"].dims == ("epoch", "anchor", "path", "bounce")
    assert paths["walls"].dtype == np.int16
    assert paths["path_valid"].dtype == np.int8
    assert truth["track_m"].shape == (6, 3)
    assert truth["reflects"].shape == (6, 2, 6)
    for shard in (passive, echo, paths, truth):
        for name, variable in shard.data_vars.items():
            assert "units" in variable.attrs, name
    np.testing.assert_array_equal(passive["tone_offset_hz"], plan.radio.grid().offsets_hz())
    np.testing.assert_array_equal(passive["time_s"], plan.times_s())
    assert passive["anchor"].values.tolist() == ["pa1", "pa2"]


def test_manifest_tells_the_links_and_not_the_plan(made: Generated, plan: FloorPlan) -> None:
    """All that the estimator needs is there; the places of walls, anchors and agent are not."""
    manifest = made.dataset.manifest
    assert manifest["complete"] is True
    assert (manifest["name"], manifest["seed"], manifest["epochs"]) == ("l-room", 1, 6)
    assert manifest["scene"] == {"name": "l-room", "sha256": plan.sha256()}
    assert manifest["radio"]["noise_variance"] == plan.radio.noise_variance()
    assert manifest["echo"]["noise_variance"] == plan.echo.noise_variance()
    assert manifest["echo"]["beams"]["beams"] == 64
    assert "numpy" in manifest["versions"]
    text = json.dumps(manifest)
    for secret in ("waypoints", "position_m", "from_m", "west", "edge", str(made.dataset.path.parent)):
        assert secret not in text, secret


def test_noise_is_that_of_the_link_budget(made: Generated, plan: FloorPlan) -> None:
    """What is left of the channels without their paths has the variance of the manifest.

    The paths are those of the paths file, so nothing but noise and the rounding to
    single precision is left; the tolerance is five standard errors of a variance.
    """
    (passive,) = made.dataset.shards("passive")
    (paths,) = made.dataset.shards("paths")
    valid = paths["path_valid"].values.astype(bool)
    azimuth, elevation = (paths[f"arrival_{name}_rad"].values for name in ("azimuth", "elevation"))
    steering = plan.radio.agent_array.array().steering(
        np.where(valid, azimuth, 0), np.where(valid, elevation, 0)
    )
    amplitude = paths["amplitude_re"].values + 1j * paths["amplitude_im"].values
    delay = np.where(valid, paths["delay_s"].values, 0.0)
    tones = np.exp(-2j * np.pi * delay[..., None] * passive["tone_offset_hz"].values)
    exact = np.einsum("ekp,ekpa,ekpt->ekat", np.where(valid, amplitude, 0), steering, tones)
    noise = passive["cfr_re"].values + 1j * passive["cfr_im"].values - exact
    expected = made.dataset.manifest["radio"]["noise_variance"]
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(expected, rel=5 / np.sqrt(noise.size))


def test_truth_is_the_plan(made: Generated, plan: FloorPlan) -> None:
    """The truth file holds the whole plan as TOML, the mirrored start, and which wall reflects when."""
    import tomllib

    truth = made.dataset.truth()
    again = parse_floorplan(tomllib.loads(truth.attrs["floorplan_toml"]))
    assert again == plan
    start, end = plan.walls_m()
    np.testing.assert_allclose(truth["vrp_m"], mirror_in_wall(plan.track()[0, :2], start, end))
    np.testing.assert_array_equal(truth.attrs["start_m"], plan.track()[0])
    flat = image_paths(plan, depth=1).flat()
    single = flat.select(flat.order == 1)
    expected = np.zeros((6, 2, 6), dtype=int)
    expected[single.epoch, single.anchor, single.walls[:, 0]] = 1
    np.testing.assert_array_equal(truth["reflects"], expected)


def test_equal_seeds_give_equal_bytes_in_another_process(plan: FloorPlan, tmp_path: Path) -> None:
    """Traced in a process of its own, in another folder, every file has the bytes that this one writes."""
    plan = updated(plan, {"tracing.engine": "sionna"})
    code = (
        "import json, sys\n"
        "from pathlib import Path\n"
        "from raytrace.dataset.generate import generate\n"
        "from raytrace.plan.files import parse_floorplan\n"
        "plan = parse_floorplan(json.loads(sys.argv[1]))\n"
        "generate(plan, Path(sys.argv[2]), seed=1)\n"
    )
    subprocess.run(
        [sys.executable, "-c", code, plan.canonical_json(), str(tmp_path / "there")],
        cwd=ROOT,
        check=True,
        timeout=120,
        capture_output=True,
    )
    made = generate(plan, tmp_path / "here", seed=1)
    assert made.report.found == made.report.expected > 50
    assert (made.report.missing, made.report.extra) == (0, 0)
    assert digests(tmp_path / "there") == digests(tmp_path / "here")


def test_other_seed_changes_the_noise_alone(made: Generated, plan: FloorPlan, tmp_path: Path) -> None:
    """Paths and truth keep their bytes; channels and echo have other noise of the same variance."""
    other = generate(plan, tmp_path / "other", seed=2)
    one, two = digests(made.dataset.path), digests(other.dataset.path)
    assert one["paths-00000.nc"] == two["paths-00000.nc"]
    assert one["truth.nc"] == two["truth.nc"]
    difference = [
        next(d.shards("passive"))["cfr_re"].values.astype(np.float64) for d in (made.dataset, other.dataset)
    ]
    variance = np.var(difference[0] - difference[1])
    count = difference[0].size
    expected = plan.radio.noise_variance()  # two real parts of half the variance each
    assert abs(variance - expected) < 5 * expected * np.sqrt(2 / count)


def test_passive_and_echo_noise_are_independent_streams(plan: FloorPlan, tmp_path: Path) -> None:
    """Another kind of sweep changes no channel: the passive noise has its own stream."""
    other = updated(plan, {"echo.model": "radar-equation", "echo.fan_rays": 0})
    data = generate(other, tmp_path / "radar", seed=1)
    same = generate(plan, tmp_path / "physical", seed=1)
    np.testing.assert_array_equal(
        next(data.dataset.shards("passive"))["cfr_re"], next(same.dataset.shards("passive"))["cfr_re"]
    )
    assert data.dataset.manifest["echo"]["model"] == "radar-equation"
    echoes = [next(d.dataset.shards("echo"))["echo_re"].values for d in (data, same)]
    assert not np.array_equal(*echoes)


def test_impairments_have_streams_of_their_own(made: Generated, plan: FloorPlan, tmp_path: Path) -> None:
    """Jitter delays whole channels and leaves the noise and the echo as they are without it."""
    late = generate(updated(plan, {"radio.timing_jitter_s": 1e-9}), tmp_path / "late", seed=1)
    one, two = digests(made.dataset.path), digests(late.dataset.path)
    assert one["echo-00000.nc"] == two["echo-00000.nc"]
    assert one["paths-00000.nc"] == two["paths-00000.nc"]
    assert one["passive-00000.nc"] != two["passive-00000.nc"]


def test_angles_are_in_the_agents_frame(plan: FloorPlan, tmp_path: Path) -> None:
    """Turning the agent turns the arrival angles back, and leaves delays and departures."""
    turned = generate(updated(plan, {"agent.heading_deg": 30.0}), tmp_path / "turned", seed=1)
    straight = image_paths(plan)
    (paths,) = turned.dataset.shards("paths")
    valid = paths["path_valid"].values.astype(bool)
    turn = paths["arrival_azimuth_rad"].values[valid] - straight.arrival_azimuth_rad[straight.valid]
    np.testing.assert_allclose(np.angle(np.exp(1j * (turn + np.deg2rad(30.0)))), 0.0, atol=1e-3)
    departure = paths["departure_azimuth_rad"].values[valid]
    np.testing.assert_allclose(departure, straight.departure_azimuth_rad[straight.valid], atol=1e-3)
    assert turned.dataset.truth().attrs["heading_rad"] == pytest.approx(np.deg2rad(30.0))


def test_progress_and_seconds(plan: FloorPlan, tmp_path: Path) -> None:
    """Progress counts up to all stages, and every stage has its seconds, in memory only."""
    told: list[tuple[int, int, str]] = []
    made = generate(plan, tmp_path / "timed", 3, lambda *now: told.append(now))
    assert [done for done, _, _ in told] == [0, 1, 2, 3, 4, 5]
    assert {total for _, total, _ in told} == {5}
    assert list(made.seconds) == ["scene", "passive", "channels", "echo", "write"]
    assert all(seconds > 0 for seconds in made.seconds.values())


def test_existing_output_is_left_alone(plan: FloorPlan, tmp_path: Path) -> None:
    """A folder that exists is an error before anything is traced, and keeps its files."""
    out = tmp_path / "mine"
    out.mkdir()
    (out / "precious.txt").write_text("keep")
    with pytest.raises(OutputExistsError, match="mine: expected a name that is free"):
        generate(plan, out, seed=1)
    assert digests(out) == {"precious.txt": hashlib.sha256(b"keep").hexdigest()}
    with pytest.raises(FileFormatError, match="expected an existing folder"):
        generate(plan, tmp_path / "no" / "such" / "folder", seed=1)
    for seed in (-1, 1.5, True):
        with pytest.raises(ConfigurationError, match="seed: expected an integer of at least 0"):
            generate(plan, tmp_path / "new", seed=seed)  # type: ignore[arg-type]
    assert not (tmp_path / "new").exists()


def test_a_failure_leaves_no_dataset(
    plan: FloorPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If tracing fails nothing has been written; if writing fails the dataset is marked incomplete."""
    monkeypatch.setattr(
        "raytrace.dataset.shard_task.specular_paths", lambda *_, **__: (_ for _ in ()).throw(MemoryError())
    )
    with pytest.raises(MemoryError):
        generate(plan, tmp_path / "early", seed=1)
    assert not (tmp_path / "early").exists()
    monkeypatch.undo()
    monkeypatch.setattr(
        "raytrace.dataset.finish.truth_shard", lambda *_: (_ for _ in ()).throw(MemoryError())
    )
    with pytest.raises(MemoryError):
        generate(plan, tmp_path / "late", seed=1)
    with pytest.raises(FileFormatError, match="expected a complete dataset"):
        open_dataset(tmp_path / "late")


def test_snapshots_clocks_and_turning_in_files(plan: FloorPlan, tmp_path: Path) -> None:
    """What the plan asks for is in the files: an axis of snapshots, Doppler shifts, clocks and headings."""
    changes = {
        "radio.snapshots": 3,
        "agent.orientation": "travel",
        "agent.speed_m_s": 5.0,
        "agent.clock": {"offset_s": 2e-8, "drift_ppm": 0.01},
        "radio.timing_jitter_s": 0.0,
        "radio.eirp_dbm": 200.0,
    }
    moving = updated(plan, changes)
    dataset = generate(moving, tmp_path / "moving", seed=1).dataset
    passive, paths, truth = (next(dataset.shards(kind)) for kind in ("passive", "paths", "truth"))
    assert passive["cfr_re"].dims == ("epoch", "anchor", "snapshot", "antenna", "tone")
    np.testing.assert_allclose(passive["snapshot_time_s"], [0.0, 1e-3, 2e-3])
    assert dataset.manifest["radio"]["snapshots"] == 3
    assert dataset.manifest["radio"]["agent_array"]["orientation"] == "travel"
    np.testing.assert_allclose(truth["agent_heading_rad"], moving.headings_rad())
    assert truth.attrs["heading_rad"] == moving.headings_rad()[0]
    np.testing.assert_allclose(truth["clock_error_s"].values[:, 0], 2e-8 + 1e-8 * truth["time_s"])

    first = {"snapshot": 1, "antenna": 0}
    cfr = passive["cfr_re"].isel(first).values + 1j * passive["cfr_im"].isel(first).values
    delay = paths["delay_s"].values + truth["clock_error_s"].values[..., None]
    turn = np.exp(2j * np.pi * paths["doppler_hz"].values * 1e-3)
    amplitude = (paths["amplitude_re"].values + 1j * paths["amplitude_im"].values) * turn
    tones = np.exp(-2j * np.pi * delay[..., None] * passive["tone_offset_hz"].values)
    azimuth = paths["arrival_azimuth_rad"].values + moving.heading_rad - moving.headings_rad()[:, None, None]
    valid = paths["path_valid"].values.astype(bool)
    antenna = moving.radio.agent_array.array().steering(azimuth, paths["arrival_elevation_rad"].values)
    weights = np.where(valid, amplitude * antenna[..., 0], 0.0)
    exact = np.einsum("ekp,ekpt->ekt", weights, np.where(valid[..., None], tones, 0.0))
    np.testing.assert_allclose(cfr, exact, atol=1e-5 * np.abs(exact).max())


def test_arrays_at_both_ends_in_files(plan: FloorPlan, tmp_path: Path) -> None:
    """Anchors with an array of two rows add an axis; the first antennas are what the manifest says."""
    changes = {
        "radio.anchor_array": {"elements": 3, "rows": 2, "pattern": "tr38901"},
        "radio.agent_array": {"elements": 2, "rows": 2, "polarization": "H"},
        "agent.epochs": 2,
    }
    dataset = generate(updated(plan, changes), tmp_path / "arrays", seed=1).dataset
    passive = next(dataset.shards("passive"))
    assert dict(passive["cfr_re"].sizes) == {
        "epoch": 2, "anchor": 2, "anchor_antenna": 6, "antenna": 4, "tone": 819
    }  # fmt: skip
    assert dataset.manifest["radio"]["anchor_array"] == {"elements": 3, "spacing_wavelengths": 0.5} | {
        "rows": 2,
        "pattern": "tr38901",
    }
    assert dataset.manifest["radio"]["agent_array"]["polarization"] == "H"
    assert dataset.manifest["statistics"]["passive"]["missing"] == 0
