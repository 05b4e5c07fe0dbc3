"""DeepMIMO scenarios read back: the paths that were written, and files that are no scenario."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.dataset import Dataset
from estimator.errors import FileFormatError
from raytrace.dataset.export_deepmimo import export_deepmimo
from raytrace.dataset.read_deepmimo import read_deepmimo
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import DIFFRACTION, REFRACTION, SPECULAR
from raytrace.propagation.reflectors import surfaces_of


@pytest.fixture(scope="module")
def scenario(sharded: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenario")
    export_deepmimo(sharded, folder)
    return folder


def test_a_scenario_is_read_as_it_was_written(scenario: Path, short_plan: FloorPlan) -> None:
    """Places, materials, faces, and every path: gains, delays and directions to single precision."""
    read = read_deepmimo(scenario)
    exact = image_paths(short_plan)
    assert read.carrier_hz == short_plan.radio.carrier_hz
    np.testing.assert_allclose(read.anchors_m, short_plan.anchors_m(), atol=1e-5)
    np.testing.assert_allclose(read.positions_m, short_plan.track(), atol=1e-5)
    eta = short_plan.permittivity_of("concrete", read.carrier_hz)
    assert read.materials["concrete"][0] == pytest.approx(eta.real)
    assert [face.name for face in read.faces] == list(short_plan.surface_names)
    assert {face.material for face in read.faces} == {"concrete"}
    corners = np.stack([face.corners_m for face in read.faces])
    np.testing.assert_allclose(corners, surfaces_of(short_plan).corners(), atol=1e-5)
    np.testing.assert_array_equal(read.paths.valid.sum(axis=2), exact.valid.sum(axis=2))
    for columns in ("delay_s", "arrival_azimuth_rad", "departure_elevation_rad"):
        ours, theirs = (
            np.sort(np.where(some.valid, getattr(some, columns), np.inf)) for some in (exact, read.paths)
        )
        width = min(ours.shape[2], theirs.shape[2])
        np.testing.assert_allclose(theirs[..., :width], ours[..., :width], rtol=1e-5, atol=1e-5)
    power = [np.sum(np.abs(some.amplitude) ** 2, axis=2) for some in (exact, read.paths)]
    np.testing.assert_allclose(power[1], power[0], rtol=1e-5)
    valid, order = read.paths.valid, read.paths.order
    assert np.all((read.paths.interactions[valid] == SPECULAR).sum(axis=1) == order[valid])
    assert np.isfinite(read.bounces_m[valid][..., 0]).sum() == order[valid].sum()


def rewritten(folder: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    path = folder / f"{name}_t000_tx000_r001.npz"
    values = change(np.load(path)[name])
    np.savez_compressed(path, **{name: values})


def test_other_interactions(scenario: Path, tmp_path: Path) -> None:
    """Codes of several digits name what happens from the transmitter on: 42 is a wall, then a corner."""
    folder = shutil.copytree(scenario, tmp_path / "other")

    def coded(values: np.ndarray) -> np.ndarray:
        return np.where(values == 11, 42, values)

    rewritten(folder, "inter", coded)
    read = read_deepmimo(folder).paths
    twice = read.valid[:, 0] & (read.order[:, 0] == 2)
    assert twice.any()
    np.testing.assert_array_equal(
        np.unique(read.interactions[:, 0][twice], axis=0), [[REFRACTION, DIFFRACTION]]
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "params.json").unlink(), "expected a file"),
        (lambda folder: (folder / "params.json").write_text("{"), "expected JSON"),
        (lambda folder: (folder / "params.json").write_text("[]"), "expected a DeepMIMO scenario"),
        (
            lambda folder: (folder / "params.json").write_text(json.dumps({"version": "3.0"})),
            "expected a DeepMIMO scenario of version 4, got '3.0'",
        ),
        (lambda folder: (folder / "delay_t000_tx001_r001.npz").unlink(), "expected a file"),
        (lambda folder: (folder / "delay_t000_tx001_r001.npz").write_bytes(b"PK"), "expected"),
        (lambda folder: rewritten(folder, "phase", lambda v: v[:-1]), "expected phase of shape"),
        (lambda folder: rewritten(folder, "inter", lambda v: np.where(v == 11, 97, v)), "digits from 1 to 4"),
        (lambda folder: rewritten(folder, "inter", lambda v: np.where(v == 11, 1e9, v)), "at most 2 digits"),
        (lambda folder: rewritten(folder, "inter_pos", lambda v: v[..., :2]), "expected inter_pos"),
        (lambda folder: rewritten(folder, "power", lambda v: np.array([None])), "expected an array"),
    ],
)
def test_what_is_no_scenario_is_refused(
    spoil: Callable[[Path], object], message: str, scenario: Path, tmp_path: Path
) -> None:
    """Missing and damaged files, other versions, shapes that do not fit, pickles: errors that say so."""
    folder = shutil.copytree(scenario, tmp_path / "bad")
    spoil(folder)
    with pytest.raises(FileFormatError, match=message):
        read_deepmimo(folder)
