"""Solid models: a horizontal cut at eye height gives the lines of a plan.

Vertical faces that the cut meets are walls, as high as the face reaches; floors,
ceilings and faces that the cut passes over or under are reported. A horizontal face at
the bottom is a floor, one at the top a ceiling.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from raytrace.importers.drawing import Drawing, Line, require_package, require_size
from raytrace.importers.options import IGNORE, UNITS_M, ImportOptions

__all__ = ["Solid", "cut", "read_model", "read_ply", "read_ply_mesh", "take_walls"]

Array = NDArray[np.float64]

_VERTICAL = np.sin(np.deg2rad(5.0))  # largest |n_z| of a wall
_LEVEL = np.cos(np.deg2rad(5.0))  # smallest |n_z| of a floor
_SLAB_SHARE = 0.25  # of the plan's bounding box, for a floor or a ceiling
_MOST_FACES = 500_000


@dataclass(frozen=True, eq=False)
class Solid:
    """An object of a model: its name, triangles and, if known, material.

    Parameters
    ----------
    name : str
        Searched for words as layers are.
    vertices : ndarray, shape (n, 3)
        In units of the file.
    faces : ndarray of int64, shape (m, 3)
        Triangles.
    material : str, optional
        Where the name alone does not tell.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int64]
    material: str | None = None


def read_ply(data: bytes, name: str, options: ImportOptions) -> Drawing:
    """Read one PLY mesh as a plan; its name tells the material, or ``options.material``, or concrete.

    Raises
    ------
    FileFormatError
        If it is no PLY, its counts do not fit its size, it has no triangles or no wall.
    """
    vertices, faces = read_ply_mesh(data)
    return cut([Solid(name, vertices, faces)], options)


def read_model(data: bytes, suffix: str, options: ImportOptions) -> Drawing:
    """Read a model of several objects: OBJ, STL, or glTF (whole, without files beside it).

    Parameters
    ----------
    data : bytes
        Contents of the file.
    suffix : str
        ``.obj``, ``.stl``, ``.glb`` or ``.gltf``; the last two have y upwards unless told otherwise.
    options : ImportOptions
        How to read it; materials follow from the names of objects and of their materials.

    Raises
    ------
    FileFormatError
        If it cannot be read, needs other files, has too many faces or no wall.
    """
    require_package("trimesh")
    import trimesh

    kind = suffix.removeprefix(".")
    try:
        apart = {"split_objects": True, "group_material": False} if kind == "obj" else {}
        scene = trimesh.load_scene(io.BytesIO(require_size(data)), file_type=kind, process=False, **apart)
        solids = [
            Solid(
                _name_of(scene.graph[node][1], mesh),
                trimesh.transform_points(mesh.vertices, scene.graph[node][0]),
                np.asarray(mesh.faces, dtype=np.int64),
            )
            for node in scene.graph.nodes_geometry
            if isinstance(mesh := scene.geometry[scene.graph[node][1]], trimesh.Trimesh) and len(mesh.faces)
        ]
    except Exception as error:  # trimesh raises errors of many kinds on damaged files
        text = f"{type(error).__name__}: {error}"[:120]
        raise FileFormatError(f"expected a whole {kind} file, could not read it: {text}") from error
    faces = sum(len(solid.faces) for solid in solids)
    if faces > _MOST_FACES:
        raise FileFormatError(f"expected at most {_MOST_FACES} faces, got {faces}")
    if not all(np.isfinite(solid.vertices).all() for solid in solids):
        raise FileFormatError("expected finite vertices, got NaN or infinity")
    up: Literal["z", "y"] = "y" if kind in ("glb", "gltf") else "z"
    return cut(solids, options if options.up is not None else replace(options, up=up))


def _name_of(geometry: str, mesh: Any) -> str:
    """Name of an object with that of its material, in one text to search for words."""
    material = getattr(getattr(mesh.visual, "material", None), "name", None)
    return f"{geometry} {material}" if material else geometry


def read_ply_mesh(data: bytes) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (n, 3) and triangles (m, 3) of a PLY file; raises FileFormatError."""
    require_package("trimesh")
    from trimesh.exchange.ply import load_ply
    from trimesh.geometry import triangulate_quads

    _check_header(require_size(data))
    try:
        loaded = load_ply(io.BytesIO(data), skip_materials=True)
        vertices = np.asarray(loaded.get("vertices", ()), dtype=np.float64)
        faces = np.asarray(triangulate_quads(loaded.get("faces", ())), dtype=np.int64)
    except Exception as error:  # trimesh raises errors of many kinds on damaged files
        text = f"{type(error).__name__}: {error}"[:120]
        raise FileFormatError(f"expected a PLY file, could not read it: {text}") from error
    if vertices.ndim != 2 or vertices.shape[-1] != 3 or not len(vertices):
        raise FileFormatError("expected vertices with x, y and z, got none")
    if faces.ndim != 2 or faces.shape[-1] != 3 or not len(faces):
        raise FileFormatError("expected faces (triangles or quadrilaterals), got none")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(
            f"expected faces of the {len(vertices)} vertices, got vertex {int(faces.max())}"
        )
    if not np.isfinite(vertices).all():
        raise FileFormatError("expected finite vertices, got NaN or infinity")
    return vertices, faces


def _check_header(data: bytes) -> None:
    """The counts of a header must fit into the file, before anything allocates them."""
    if not data.startswith(b"ply"):
        raise FileFormatError(f"expected a PLY file that starts with 'ply', got {data[:12]!r}")
    end = data.find(b"end_header")
    if end < 0:
        raise FileFormatError("expected a PLY header that ends with end_header, it does not")
    header = data[:end].decode("ascii", errors="replace")
    if not re.search(
        r"^format (ascii|binary_little_endian|binary_big_endian) 1\.0\s*$", header, re.MULTILINE
    ):
        raise FileFormatError("expected the PLY format ascii or binary, version 1.0")
    room = len(data) - end
    for name, count in re.findall(r"^element (\S+) (\S+)\s*$", header, re.MULTILINE):
        if not count.isdigit() or int(count) * 2 > room:
            raise FileFormatError(f"element {name}: expected a count that fits into the file, got {count}")
        if name == "face" and int(count) > _MOST_FACES:
            raise FileFormatError(f"element face: expected at most {_MOST_FACES}, got {count}")


def cut(solids: list[Solid], options: ImportOptions) -> Drawing:
    """Cut solids at ``options.cut_m`` above the lowest point.

    Parameters
    ----------
    solids : list of Solid
        Objects of the model.
    options : ImportOptions
        Unit (metres by default), upward axis, materials.

    Raises
    ------
    FileFormatError
        If the cut meets no vertical face.
    """
    drawing = Drawing()
    unit = options.unit or "m"
    drawing.report.notes.append(
        f"unit {unit}, {options.up or 'z'} upwards, cut {options.cut_m:g} m above the floor"
    )
    placed = [(solid, _upright(solid.vertices, options.up or "z") * UNITS_M[unit]) for solid in solids]
    if not placed:
        raise FileFormatError("expected objects with faces, got none")
    everything = np.concatenate([vertices for _, vertices in placed])
    low, high = everything.min(axis=0), everything.max(axis=0)
    for solid, vertices in placed:
        material = solid.material or options.material_of(solid.name) or "concrete"
        if material == IGNORE:
            drawing.report.dropped[f"object {solid.name}, ignored"] += 1
            continue
        triangles = (vertices - (0.0, 0.0, low[2]))[solid.faces]
        _take_slabs(solid.name, triangles, material, high - low, drawing)
        take_walls(solid.name, triangles, material, options, drawing)
    if not drawing.lines:
        raise FileFormatError(
            f"expected vertical faces {options.cut_m:g} m above the lowest point, got none "
            f"(the model is {high[2] - low[2]:.3g} m high)"
        )
    return drawing


def _upright(vertices: Array, up: str) -> Array:
    """Vertices with z upwards: from (x, y, z) with y upwards to (x, -z, y)."""
    return vertices if up == "z" else vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0)


def _normals(triangles: Array) -> tuple[Array, Array]:
    """Unit normals (zero where there is no area) and areas of triangles (m, 3, 3)."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    twice = np.linalg.norm(across, axis=1)
    return across / np.where(twice > 0, twice, 1.0)[:, None], 0.5 * twice


def _take_slabs(name: str, triangles: Array, material: str, size: Array, drawing: Drawing) -> None:
    """A large level face at the bottom is a floor, at the top a ceiling."""
    normal, area = _normals(triangles)
    level = np.abs(normal[:, 2]) >= _LEVEL
    middle = triangles[..., 2].mean(axis=1)
    for slab, at in (("floor", 0.0), ("ceiling", size[2])):
        mine = level & (np.abs(middle - at) < 0.5)
        if area[mine].sum() >= _SLAB_SHARE * size[0] * size[1] and size[2] > 1.0:
            setattr(drawing, slab, material)
            drawing.report.kept[f"faces of {name} as {slab} of {material}"] += int(mine.sum())
            level = level & ~mine
    if level.any():
        drawing.report.dropped[f"level face of {name}"] += int(level.sum())


def take_walls(
    name: str,
    triangles: Array,
    material: str,
    options: ImportOptions,
    drawing: Drawing,
    top_m: float | None = None,
) -> None:
    """Add a line where an upright face meets the cut, as high as the face reaches.

    Parameters
    ----------
    name : str
        What the faces belong to, for the report.
    triangles : ndarray, shape (n, 3, 3)
        Faces, metres above the floor.
    material : str
        What they are made of.
    options : ImportOptions
        Height of the cut, and thickness of single faces.
    drawing : Drawing
        Gets the lines, and its report what became of which face.
    top_m : float, optional
        Height of all lines in place of that of each face, metres.
    """
    normal, area = _normals(triangles)
    report = drawing.report
    upright = (np.abs(normal[:, 2]) <= _VERTICAL) & (area > 0)
    slanted = ~upright & (np.abs(normal[:, 2]) < _LEVEL) & (area > 0)
    report.dropped[f"slanted face of {name}"] += int(slanted.sum())
    report.dropped[f"face of {name} without area"] += int(np.sum(area <= 0))
    side = triangles[..., 2] - options.cut_m
    side[side == 0.0] = 1e-9  # a vertex in the cut counts as above it
    crosses = upright & (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    report.dropped[f"upright face of {name}, below or above the cut"] += int(np.sum(upright & ~crosses))
    report.kept[f"upright face of {name} as {material}"] += int(crosses.sum())
    for triangle, height in zip(triangles[crosses], side[crosses], strict=True):
        ends = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            if height[a] * height[b] < 0:
                share = height[a] / (height[a] - height[b])
                x, y, _ = triangle[a] + share * (triangle[b] - triangle[a])
                ends.append((float(x), float(y)))
        start, end = ends
        if start != end:
            top = round(float(triangle[:, 2].max()), 4) if top_m is None else top_m
            drawing.add(Line(start, end, material, top, options.thickness_m, name))
    report.kept, report.dropped = +report.kept, +report.dropped
