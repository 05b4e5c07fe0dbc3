"""The joint map of a smoothed run: what it has in common, and which path was which feature."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import xarray as xr

from estimator.errors import FileFormatError
from estimator.joint_map import JointMap
from estimator.measurements import AnchorPaths
from estimator.result import load_result, save_result
from estimator.slam import run_slam
from estimator.slam.models.state_vector import Layout
from estimator.slam.smoothing.map_evidence import feature_walls
from estimator.slam.smoothing.refine import RefineConfig, refine
from estimator.waveform import SPEED_OF_LIGHT_M_S


@pytest.fixture(scope="module")
def run(room):
    """Measurements of 90 epochs whose gains tell their places, and the run smoothed."""
    whole = room.measure(71)
    epochs = tuple(
        replace(
            epoch,
            paths=tuple(
                AnchorPaths(paths.delay_s, paths.delay_std_s, -100.0 - np.arange(len(paths)))
                for paths in epoch.paths
            ),
        )
        for epoch in whole.epochs[:90]
    )
    measurements = replace(whole, epochs=epochs)
    return measurements, refine(measurements, run_slam(measurements))


def test_features_name_their_walls():
    """Line of sight, single bounces and ordered pairs."""
    layout = Layout(anchors=1, slots=3)
    walls = feature_walls(layout, np.array([0, 1, 3, 1 + 3 + 3 * 2 + 0]))
    np.testing.assert_array_equal(walls, [[-1, -1], [0, -1], [2, -1], [2, 0]])


def test_paths_are_those_that_were_measured(run):
    """Each path's length and gain are found again where the joint map says that it was measured."""
    measurements, smoothed = run
    joint = smoothed.joint
    assert len(joint.path_epoch) > 300
    for i in range(0, len(joint.path_epoch), 17):
        paths = measurements.epochs[joint.path_epoch[i]].paths[joint.path_anchor[i]]
        number = joint.path_number[i]
        assert joint.path_length_m[i] == pytest.approx(paths.delay_s[number] * SPEED_OF_LIGHT_M_S)
        assert joint.path_gain_db[i] == -100.0 - number
    assert np.sqrt(np.mean(joint.path_residual_m**2)) < 0.2
    assert set(joint.bounces) == {0, 1, 2}


def test_covariances_are_those_of_the_result(run):
    """Blocks of the joint covariance are the covariances of the last epoch's anchors and walls."""
    _, smoothed = run
    joint = smoothed.joint
    anchors, walls = smoothed.anchor_covariance_m2[-1], smoothed.wall_covariance_m2[-1]
    for i, block in enumerate([*anchors, *walls]):
        part = slice(2 * i, 2 * i + 2)
        np.testing.assert_allclose(joint.map_covariance_m2[part, part], block)
    assert np.linalg.eigvalsh(joint.map_covariance_m2).min() > -1e-9
    assert np.abs(joint.map_covariance_m2[4:6, 6:8]).max() > 0.0


def test_extents_lie_on_the_true_walls(room, run):
    """Bounces were where the walls are."""
    _, smoothed = run
    for vrp, extent in zip(smoothed.wall_mean_m[-1], smoothed.joint.wall_extent_m, strict=True):
        if np.isnan(extent).any():
            continue
        assert extent[0] <= extent[1]
        tangent = np.array([-vrp[1], vrp[0]]) / np.linalg.norm(vrp)
        points = 0.5 * vrp + extent[:, None] * tangent + room.track[0]
        assert points.min() > -1.0
        assert points.max() < 81.0


def test_a_lag_tells_the_map_too(run):
    """Smoothed with a lag, the joint map is that of the last window."""
    measurements, _ = run
    part = replace(measurements, epochs=measurements.epochs[:40])
    lagged = refine(part, run_slam(part), config=RefineConfig(lag=5))
    assert lagged.joint.map_covariance_m2.shape[0] == 2 * (2 + len(lagged.wall_id))


def test_a_joint_map_comes_back_bit_by_bit(run, tmp_path):
    """Every field of the file is that of the result."""
    _, smoothed = run
    save_result(smoothed, tmp_path / "r.nc")
    loaded = load_result(tmp_path / "r.nc").joint
    for entry in fields(JointMap):
        np.testing.assert_array_equal(getattr(smoothed.joint, entry.name), getattr(loaded, entry.name))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.drop_vars("path_walls"), r"expected the variables \['path_walls'\]"),
        (lambda d: d.assign(path_anchor=d["path_anchor"] + 7), "path_anchor: expected numbers from 0 to 1"),
        (lambda d: d.assign(carrier_hz=-1.0), "carrier_hz: expected a positive number, got -1.0"),
        (lambda d: d.isel(map=slice(2)), "map_covariance_m2: expected shape"),
    ],
)
def test_a_joint_map_that_does_not_fit_is_refused(run, tmp_path, change, message):
    """A file is told apart by what does not fit."""
    save_result(run[1], tmp_path / "r.nc")
    with xr.open_dataset(tmp_path / "r.nc", engine="h5netcdf") as data:
        changed = change(data.load())
    changed.to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    with pytest.raises(FileFormatError, match=message):
        load_result(tmp_path / "changed.nc")
