"""A floor plan as a scene for other ray tracers: Mitsuba's XML as Sionna RT loads it, meshes, and devices.

FOLDER/
  scene.xml        materials of the ITU's table by name and thickness, or of the plan's own; shapes
  meshes/*.ply     a rectangle for every wall, floor and ceiling
  devices.json     carrier, anchors and agent's height: scenes hold none
"""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import write_text
from estimator.errors import FileFormatError
from raytrace.plan.floorplan import FloorPlan, Slab, Wall
from raytrace.propagation.reflectors import surfaces_of

__all__ = ["export_scene"]


def export_scene(plan: FloorPlan, out: Path) -> None:
    """Write a plan's scene into an empty folder; coordinates are the plan's, metres.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    out : Path
        The folder.

    Raises
    ------
    FileFormatError
        If the folder is not there.
    """
    if not out.is_dir():
        raise FileFormatError(f"{out}: expected an existing folder, there is none")
    (out / "meshes").mkdir()
    root = ElementTree.Element("scene", version="2.1.0")
    kinds: dict[tuple[str, float], str] = {}
    for slab in plan.surface_slabs:
        kind = slab.material, slab.thickness_m
        if kind not in kinds:
            kinds[kind] = f"mat-{slab.material}-{len(kinds)}"
            _material(root, plan, slab, kinds[kind])
    corners = surfaces_of(plan).corners()
    for number, slab in enumerate(plan.surface_slabs):
        file = f"meshes/surface-{number:04d}.ply"
        write_text(_ply(corners[number]), out / file)
        shape = ElementTree.SubElement(root, "shape", type="ply", id=f"mesh-{number:04d}")
        _value(shape, "string", "filename", file)
        _value(shape, "boolean", "face_normals", "true")
        ElementTree.SubElement(shape, "ref", id=kinds[slab.material, slab.thickness_m], name="bsdf")
    ElementTree.indent(root)
    write_text(ElementTree.tostring(root, encoding="unicode") + "\n", out / "scene.xml")
    devices = {
        "carrier_hz": plan.radio.carrier_hz,
        "anchors": {anchor.name: list(anchor.position_m) for anchor in plan.anchors},
        "agent_height_m": plan.agent.height_m,
        "surfaces": {f"mesh-{number:04d}": name for number, name in enumerate(plan.surface_names)},
    }
    write_text(json.dumps(devices, indent=2) + "\n", out / "devices.json")


def _material(root: ElementTree.Element, plan: FloorPlan, slab: Wall | Slab, name: str) -> None:
    own = plan.materials.get(slab.material)
    kind = "itu-radio-material" if own is None else "radio-material"
    node = ElementTree.SubElement(root, "bsdf", type=kind, id=name)
    if own is None:
        _value(node, "string", "type", slab.material)
    else:
        _value(node, "float", "relative_permittivity", repr(own.relative_permittivity))
        _value(node, "float", "conductivity", repr(own.conductivity_s_m))
    _value(node, "float", "thickness", repr(slab.thickness_m))
    scattering = plan.scattering_of(slab.material)
    if scattering > 0.0:
        _value(node, "float", "scattering_coefficient", repr(scattering))


def _value(node: ElementTree.Element, kind: str, name: str, value: str) -> None:
    ElementTree.SubElement(node, kind, name=name, value=value)


def _ply(corners: NDArray[np.float64]) -> str:
    """A rectangle (4, 3) as two triangles, in PLY's text form."""
    lines = ["ply", "format ascii 1.0", "element vertex 4"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += ["element face 2", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{value:.7g}" for value in corner) for corner in corners]
    return "\n".join([*lines, "3 0 1 2", "3 0 2 3"]) + "\n"
