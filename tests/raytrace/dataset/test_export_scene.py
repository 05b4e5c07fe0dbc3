"""Exported scenes, loaded by Sionna RT itself."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import FileFormatError
from raytrace.dataset.export_scene import export_scene
from raytrace.importers.mitsuba import read_mitsuba
from raytrace.importers.options import ImportOptions
from raytrace.plan.files import load_floorplan, updated
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.backend import prepare
from raytrace.propagation.images import image_paths


@pytest.fixture(scope="module")
def plan() -> FloorPlan:
    """A room of four materials, one of its own."""
    corners = [[0.0, 0.0], [9.0, 0.0], [9.0, 6.0], [0.0, 6.0]]
    slabs = [("concrete", 0.2), ("glass", 0.02), ("brick", 0.12), ("panel", 0.05)]
    walls = [
        {"name": f"w{i}", "from_m": corners[i], "to_m": corners[(i + 1) % 4], "material": m, "thickness_m": d}
        for i, (m, d) in enumerate(slabs)
    ]
    return updated(
        load_floorplan("hall"),
        {
            "name": "room",
            "walls": walls,
            "materials": {"panel": {"relative_permittivity": 3.0, "conductivity_s_m": 0.1}},
            "anchors": [{"name": "pa1", "position_m": [2.0, 4.5, 2.2]}],
            "agent.waypoints_m": [[6.0, 2.0], [7.0, 3.0]],
            "agent.epochs": 2,
            "tracing.engine": "images",
        },
    )


@pytest.fixture(scope="module")
def folder(plan: FloorPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scene")
    export_scene(plan, out)
    return out


def test_sionna_finds_the_same_paths(plan: FloorPlan, folder: Path) -> None:
    """Delays and powers of the loaded scene are those of the image method."""
    prepare()
    import sionna.rt as rt

    scene = rt.load_scene(str(folder / "scene.xml"))
    scene.frequency = plan.radio.carrier_hz
    devices = json.loads((folder / "devices.json").read_text())
    scene.tx_array = scene.rx_array = rt.PlanarArray(
        num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5, pattern="iso", polarization="V"
    )
    agent = plan.track()[0]
    scene.add(rt.Transmitter("tx", devices["anchors"]["pa1"]))
    scene.add(rt.Receiver("rx", agent.tolist()))
    found = rt.PathSolver()(
        scene, max_depth=2, samples_per_src=100_000, diffuse_reflection=False, refraction=False, seed=1
    )
    real, imaginary = found.a
    power = np.squeeze(np.array(real) ** 2 + np.array(imaginary) ** 2)
    delay = np.squeeze(np.array(found.tau))
    true = image_paths(plan, agent[None]).flat()
    np.testing.assert_allclose(np.sort(delay[delay > 0.0]), np.sort(true.delay_s), rtol=1e-5)
    np.testing.assert_allclose(np.sort(power[delay > 0.0]), np.sort(np.abs(true.amplitude) ** 2), rtol=0.02)


def test_the_importer_reads_it_back(plan: FloorPlan, folder: Path) -> None:
    """Cut at eye height the scene has the walls of the plan."""
    meshes = {file.name: file.read_bytes() for file in (folder / "meshes").iterdir()}
    drawing = read_mitsuba((folder / "scene.xml").read_bytes(), ImportOptions(), meshes)
    assert len(meshes) == len(plan.walls)
    assert {line.material for line in drawing.lines} >= {"concrete", "glass", "brick"}
    ends = np.array([[line.start_m, line.end_m] for line in drawing.lines])
    np.testing.assert_allclose(
        [ends.min(axis=(0, 1)), ends.max(axis=(0, 1))], [[0.0, 0.0], [9.0, 6.0]], atol=1e-6
    )


def test_a_folder_that_is_not_there_is_refused(plan: FloorPlan, tmp_path: Path) -> None:
    """The folder has to be made."""
    with pytest.raises(FileFormatError, match="expected an existing folder"):
        export_scene(plan, tmp_path / "none")
