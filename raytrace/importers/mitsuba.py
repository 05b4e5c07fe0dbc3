"""Mitsuba scenes (XML): rectangles, cubes and given PLY meshes, cut at eye height.

The XML is read without entities, document types and includes. A mesh file that the scene
names is read only if it was given explicitly; its name in the scene is compared with
that of the given files, and never opened.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from raytrace.importers.drawing import Drawing, require_size
from raytrace.importers.mesh import Solid, cut, read_ply_mesh
from raytrace.importers.options import ImportOptions
from raytrace.importers.safe_xml import parse_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["read_mitsuba"]

Array = NDArray[np.float64]

_MOST_SHAPES = 20_000
_RECTANGLE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=np.float64)
_CUBE = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
_QUADS = np.array([(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)])


def read_mitsuba(data: bytes, options: ImportOptions, meshes: Mapping[str, bytes] | None = None) -> Drawing:
    """Read a Mitsuba 3 scene.

    Parameters
    ----------
    data : bytes
        Contents of the XML file.
    options : ImportOptions
        How to read it. The material is that of the shape's own name or of the BSDF
        that it refers to (as ``mat-itu_concrete``).
    meshes : mapping of str to bytes, optional
        Contents of PLY files by their name (without folder).

    Raises
    ------
    FileFormatError
        If it is no XML or no scene, has a document type or entities, an attribute cannot
        be understood, or there is no wall.
    """
    root = parse_xml(require_size(data))
    if root.tag != "scene":
        raise FileFormatError(f"expected a <scene>, got <{root.tag}>")
    values = {node.get("name", ""): node.get("value", "") for node in root.iter("default")}
    bsdfs = {node.get("id", ""): _bsdf_name(node) for node in root.iter("bsdf") if node.get("id")}
    shapes = list(root.iter("shape"))
    if len(shapes) > _MOST_SHAPES:
        raise FileFormatError(f"expected at most {_MOST_SHAPES} shapes, got {len(shapes)}")
    solids, dropped = [], []
    for index, node in enumerate(shapes):
        where = f"shape[{index}] ({node.get('id') or node.get('type')})"
        geometry = _geometry(where, node, values, meshes or {})
        if isinstance(geometry, str):
            dropped.append(geometry)
            continue
        vertices, faces = geometry
        matrix = _to_world(where, node, values)
        placed = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        if not np.isfinite(placed).all():
            raise FileFormatError(f"{where}: expected finite coordinates, got NaN or infinity")
        name = node.get("id") or node.get("name") or f"shape {index}"
        solids.append(Solid(name, placed, faces, _material(node, bsdfs, options)))
    if not solids:
        why = ", ".join(sorted(set(dropped))) or "the scene has none"
        raise FileFormatError(f"expected shapes that can be read, got none: {why}")
    drawing = cut(solids, options)
    drawing.report.dropped.update(dropped)
    for tag in ("include", "path", "texture", "sensor", "emitter", "integrator", "medium"):
        drawing.report.dropped[f"<{tag}>"] += len(list(root.iter(tag)))
    drawing.report.dropped = +drawing.report.dropped
    return drawing


def _geometry(
    where: str, node: Element, values: Mapping[str, str], meshes: Mapping[str, bytes]
) -> tuple[Array, NDArray[np.int64]] | str:
    """Vertices and triangles of a shape before it is placed, or why it is left out."""
    kind = node.get("type")
    if kind == "rectangle":
        return _RECTANGLE, _triangles(np.arange(4)[None])
    if kind == "cube":
        return _CUBE, _triangles(_QUADS)
    if kind != "ply":
        return f"shape of type {kind}"
    name = next((n.get("value", "") for n in node.findall("string") if n.get("name") == "filename"), "")
    if not name:
        raise FileFormatError(f"{where}: expected a string 'filename', it is missing")
    plain = PurePosixPath(PureWindowsPath(_value(where, name, values)).as_posix()).name
    if plain not in meshes:
        return f"mesh {plain}, which was not given"
    try:
        return read_ply_mesh(meshes[plain])
    except FileFormatError as error:
        raise FileFormatError(f"{where}: {plain}: {error}") from error


def _triangles(quads: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _bsdf_name(node: Element) -> str:
    """Names and types of a BSDF and those within it, in one string to search."""
    inner = [
        str(n.get("value")) for n in node.iter("string") if n.get("name") in ("type", "itu_type", "name")
    ]
    return " ".join([str(node.get("id")), str(node.get("name", "")), *inner])


def _material(node: Element, bsdfs: Mapping[str, str], options: ImportOptions) -> str | None:
    """Material of the BSDF that a shape has or refers to; ``None`` leaves it to its name."""
    own = [_bsdf_name(bsdf) for bsdf in node.findall("bsdf")]
    referred = [bsdfs.get(ref.get("id", ""), ref.get("id", "")) for ref in node.findall("ref")]
    for name in (*own, *referred):
        found = options.material_of(name)
        if found is not None:
            return found
    return None


def _value(where: str, text: str, values: Mapping[str, str]) -> str:
    """A value with its ``$names`` replaced by the scene's defaults."""

    def replaced(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise FileFormatError(f"{where}: expected a <default> for ${match[1]}, there is none")
        return values[match[1]]

    return re.sub(r"\$(\w+)", replaced, text)


def _numbers(where: str, text: str, values: Mapping[str, str], counts: tuple[int, ...]) -> list[float]:
    parts = re.split(r"[\s,]+", _value(where, text, values).strip())
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        wanted = " or ".join(map(str, counts))
        raise FileFormatError(f"{where}: expected {wanted} finite numbers, got {text[:60]!r}")
    return numbers


def _to_world(where: str, node: Element, values: Mapping[str, str]) -> Array:
    """The 4 x 4 matrix of a shape's ``to_world``: its steps from the first to the last."""
    matrix = np.eye(4)
    for transform in node.findall("transform"):
        if transform.get("name") not in ("to_world", "toWorld"):
            continue
        for step in transform:
            matrix = _step(f"{where}.{step.tag}", step, values) @ matrix
    return matrix


def _step(where: str, step: Element, values: Mapping[str, str]) -> Array:
    if step.tag == "matrix":
        cells = _numbers(where, step.get("value", ""), values, (9, 16))
        matrix = np.eye(4)
        size = 3 if len(cells) == 9 else 4
        matrix[:size, :size] = np.reshape(cells, (size, size))
        return matrix
    if step.tag not in ("translate", "scale", "rotate"):
        raise FileFormatError(f"{where}: expected translate, scale, rotate or matrix, got <{step.tag}>")
    default = "1" if step.tag == "scale" else "0"
    if "value" in step.attrib:
        given = _numbers(where, step.get("value", ""), values, (1, 3))
        vector = np.array(given if len(given) == 3 else given * 3)
    else:
        vector = np.array([_numbers(where, step.get(axis, default), values, (1,))[0] for axis in "xyz"])
    matrix = np.eye(4)
    if step.tag == "translate":
        matrix[:3, 3] = vector
    elif step.tag == "scale":
        matrix[:3, :3] = np.diag(vector)
    else:
        angle = math.radians(_numbers(where, step.get("angle", ""), values, (1,))[0])
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            raise FileFormatError(f"{where}: expected an axis that is not zero, got {step.attrib}")
        x, y, z = vector / length
        skew = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
        matrix[:3, :3] += math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew  # Rodrigues
    return matrix
