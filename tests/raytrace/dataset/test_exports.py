"""Others really read the data: netCDF by xarray and h5py, .mat by SciPy and Octave, DeepMIMO's layout."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import xarray as xr

from estimator.dataset import Dataset
from raytrace.dataset.export_deepmimo import export_deepmimo
from raytrace.dataset.export_mat import export_mat
from raytrace.dataset.shards import stored_paths
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.bounces import bounce_points
from raytrace.propagation.images import image_paths
from raytrace.propagation.reflectors import surfaces_of

Digests = Callable[[Path], dict[str, str]]


def complex_of(shard: xr.Dataset, name: str) -> np.ndarray:
    return shard[f"{name}_re"].values + 1j * shard[f"{name}_im"].values


@pytest.fixture(scope="module")
def matlab(sharded: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("matlab")
    export_mat(sharded, folder)
    return folder


@pytest.fixture(scope="module")
def scenario(sharded: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenario")
    export_deepmimo(sharded, folder)
    return folder


def test_netcdf_is_plain_hdf5(sharded: Dataset) -> None:
    """h5py reads every variable of every file, with CF's units, to the values that xarray gives."""
    for entry in sharded.manifest["shards"]:
        file = sharded.path / entry["file"]
        with xr.open_dataset(file, engine="h5netcdf") as data, h5py.File(file) as raw:
            assert data.attrs["format"] == f"hapslam-dataset/{entry['kind']}"
            assert data.attrs["Conventions"] == "CF-1.11"
            for name, variable in data.data_vars.items():
                np.testing.assert_array_equal(raw[str(name)][...], variable.values)
                units = raw[str(name)].attrs["units"]
                assert (units.decode() if isinstance(units, bytes) else units) == variable.attrs["units"]
                assert not np.iscomplexobj(raw[str(name)])


def test_mat_files_hold_the_shards(matlab: Path, sharded: Dataset) -> None:
    """SciPy reads each file to the shard's arrays, complex ones joined, in the same order of axes."""
    names = {entry["file"].replace(".nc", ".mat") for entry in sharded.manifest["shards"]}
    assert {file.name for file in matlab.iterdir()} == {*names, "manifest.json"}
    for index, shard in enumerate(sharded.shards("passive")):
        read = scipy.io.loadmat(matlab / f"passive-{index:05d}.mat")
        assert read["cfr"].dtype == np.complex64
        np.testing.assert_array_equal(read["cfr"], complex_of(shard, "cfr"))
        np.testing.assert_array_equal(read["cir"], complex_of(shard, "cir"))
        np.testing.assert_array_equal(read["time_s"][:, 0], shard["time_s"])
        assert [str(name[0]) for name in read["anchor"][:, 0]] == ["pa1", "pa2"]
    (first, *_) = sharded.shards("paths")
    read = scipy.io.loadmat(matlab / "paths-00000.mat")
    np.testing.assert_array_equal(read["amplitude"], complex_of(first, "amplitude"))
    np.testing.assert_array_equal(read["walls"], first["walls"])
    truth = scipy.io.loadmat(matlab / "truth.mat")
    np.testing.assert_array_equal(truth["track_m"], sharded.truth()["track_m"])
    assert str(truth["floorplan_toml"][0]) == sharded.truth().attrs["floorplan_toml"]


def test_mat_files_are_the_same_every_time(
    matlab: Path, sharded: Dataset, tmp_path: Path, digests: Digests
) -> None:
    """No time of writing is in them."""
    export_mat(sharded, tmp_path)
    assert digests(tmp_path) == digests(matlab)


def test_octave_reads_mat_files(matlab: Path, sharded: Dataset) -> None:
    """GNU Octave loads the channels as complex single precision and finds the same power."""
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("GNU Octave is not installed")
    program = (
        f"s = load('{matlab / 'passive-00000.mat'}'); "
        "printf('%s %d %d %.12g', class(s.cfr), size(s.cfr, 1), size(s.cfr, 4), "
        "sum(abs(double(s.cfr(:))) .^ 2))"
    )
    done = subprocess.run([octave, "--eval", program], capture_output=True, text=True, timeout=60, check=True)
    kind, epochs, tones, power = done.stdout.split()
    (first, *_) = sharded.shards("passive")
    assert (kind, int(epochs), int(tones)) == ("single", 10, 819)
    exact = np.sum(np.abs(complex_of(first, "cfr").astype(np.complex128)) ** 2)
    assert float(power) == pytest.approx(exact, rel=1e-6)


def test_bounces_are_on_surfaces_and_make_the_length(sharded: Dataset, short_plan: FloorPlan) -> None:
    """Points reconstructed from the surfaces alone lie on them, and the legs add up to the delay."""
    (first, *_) = sharded.shards("paths")
    paths = stored_paths(first, short_plan.heading_rad).flat()
    positions = short_plan.track()[:10]
    points = bounce_points(short_plan, paths, positions)
    surfaces = surfaces_of(short_plan)
    for bounce in range(2):
        met = paths.order > bounce
        wall = paths.walls[met, bounce]
        off = np.sum((points[met, bounce] - surfaces.origin[wall]) * surfaces.normal[wall], axis=-1)
        assert np.abs(off).max() < 1e-9
        assert np.isnan(points[~met, bounce]).all()
    ends = np.stack([short_plan.anchors_m()[paths.anchor], positions[paths.epoch]])
    filled = np.where(np.isnan(points), ends[1][:, None], points)
    legs = np.diff(np.concatenate([ends[0][:, None], filled, ends[1][:, None]], axis=1), axis=1)
    length = np.linalg.norm(legs, axis=-1).sum(axis=-1)
    np.testing.assert_allclose(length, paths.delay_s * 299_792_458.0, atol=1e-3)


def test_a_scenario_has_deepmimos_files(scenario: Path, short_plan: FloorPlan) -> None:
    """Names, shapes, units and the parameters that its loader asks for."""
    quantities = ["aoa_az", "aoa_el", "aod_az", "aod_el", "delay", "inter", "inter_pos", "phase", "power"]
    matrices = {
        f"{name}_t000_tx{anchor:03d}_r001.npz"
        for name in [*quantities, "rx_pos", "tx_pos"]
        for anchor in range(2)
    }
    assert {file.name for file in scenario.iterdir()} == {
        *matrices,
        "vertices.npz",
        "objects.json",
        "params.json",
    }
    params = json.loads((scenario / "params.json").read_text())
    assert set(params) == {"version", "rt_params", "txrx_sets", "materials", "scene"}
    assert params["rt_params"]["frequency"] == 28e9
    sets = params["txrx_sets"]
    assert (sets["txrx_set_0"]["is_tx"], sets["txrx_set_0"]["num_points"]) == (True, 2)
    assert (sets["txrx_set_1"]["is_rx"], sets["txrx_set_1"]["num_points"]) == (True, 40)
    assert params["materials"]["material_0"]["name"] == "concrete"
    assert params["materials"]["material_0"]["conductivity"] == pytest.approx(0.0462 * 28**0.7822, rel=1e-6)
    objects = json.loads((scenario / "objects.json").read_text())
    vertices = np.load(scenario / "vertices.npz")["vertices"]
    assert [thing["name"] for thing in objects] == list(short_plan.surface_names)
    west = vertices[objects[0]["face_vertex_idxs"][0]]
    assert {tuple(corner) for corner in west.tolist()} == {(0, y, z) for y in (0, 40) for z in (0, 3)}


def test_a_scenarios_channels_are_ours(scenario: Path, sharded: Dataset, short_plan: FloorPlan) -> None:
    """DeepMIMO's formula, sqrt(power) exp(j phase) exp(-j 2 pi f delay), gives the image method's channels.

    The matrices are single precision, and so are the traced delays: 2e-5 of a wavelength's phase
    at the carrier is in the phase, so the sums agree to a percent of the strongest.
    """
    offsets = np.arange(0.0, 200e6, 5e6)
    exact = image_paths(short_plan)
    for anchor in range(2):
        read = {
            name: np.load(scenario / f"{name}_t000_tx{anchor:03d}_r001.npz")[name].astype(np.float64)
            for name in ("power", "phase", "delay", "inter", "aoa_el", "aod_az", "inter_pos", "rx_pos")
        }
        assert read["power"].shape[0] == 40
        assert read["inter_pos"].shape[-2:] == (2, 3)
        present = np.isfinite(read["power"])
        strongest_first = np.where(present, read["power"], -np.inf)
        assert np.all(strongest_first[:, :-1] >= strongest_first[:, 1:])
        np.testing.assert_array_equal(present.sum(axis=1), exact.valid[:, anchor].sum(axis=1))
        gain = np.where(present, 10 ** (read["power"] / 20) * np.exp(1j * np.deg2rad(read["phase"])), 0)
        turn = np.exp(-2j * np.pi * np.where(present, read["delay"], 0)[..., None] * offsets)
        theirs = np.einsum("ep,epf->ef", gain, turn)
        amplitude = np.where(exact.valid, exact.amplitude, 0)[:, anchor]
        delay = np.where(exact.valid, exact.delay_s, 0)[:, anchor]
        ours = np.einsum("ep,epf->ef", amplitude, np.exp(-2j * np.pi * delay[..., None] * offsets))
        assert np.abs(theirs - ours).max() < 0.02 * np.abs(ours).max()
        assert set(np.unique(read["inter"][present])) == {0, 1, 11}
        np.testing.assert_allclose(read["rx_pos"], short_plan.track(), atol=1e-5)
        assert np.nanmin(read["aoa_el"]) > 80  # nearly level: a zenith angle, not an elevation
