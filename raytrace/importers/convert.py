"""Drawings of other programs to floor plans, with a report of what became of everything.

A file is read once, whole, and by its suffix: ``.dxf``, ``.geojson`` or ``.json``,
``.xml`` (Mitsuba), ``.ply``, ``.obj``, ``.stl``, ``.glb``, ``.gltf``, ``.osm``, ``.ifc``,
and ``.zip`` or a folder (IMDF). Nothing else is opened: references to other files are reported, and meshes
of a Mitsuba scene are given explicitly. Nothing in a file is run.

Lines then go the same way: double ones become one surface, ends are led to the walls
they run into, and an agent and anchors are placed where the file marks none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from estimator.errors import FileFormatError, InputError
from raytrace.importers.collapse import collapse
from raytrace.importers.drawing import Drawing, ImportReport, Line, Point, require_size
from raytrace.importers.dxf import read_dxf
from raytrace.importers.geojson import read_geojson
from raytrace.importers.ifc import read_ifc
from raytrace.importers.imdf import is_imdf, read_imdf
from raytrace.importers.joins import join_ends
from raytrace.importers.mesh import read_model, read_ply
from raytrace.importers.mitsuba import read_mitsuba
from raytrace.importers.options import ImportOptions
from raytrace.importers.osm import read_osm
from raytrace.importers.units import questioned
from raytrace.plan.files import parse_floorplan
from raytrace.plan.floorplan import FORMAT, VERSION, FloorPlan
from raytrace.plan.placement import Walk, place_anchors, plan_walk
from raytrace.plan.sound_walls import sound_walls
from raytrace.plan.space import main_space
from raytrace.plan.surfaces import Wall

__all__ = ["SUFFIXES", "Imported", "floorplan_of", "import_floorplan", "read_drawing"]

MODELS = (".obj", ".stl", ".glb", ".gltf")
SUFFIXES = (".dxf", ".geojson", ".json", ".xml", ".ply", *MODELS, ".osm", ".ifc", ".zip")

_MOST_WALLS = 20_000
# Repairs of walls that are told one by one; and a space below this share of the plan is hardly the right one.
_MOST_TOLD = 8
_SMALL_SHARE = 0.1
# Beyond this, single precision of the tracer loses the millimetre.
_FAR_M = 1_000.0


@dataclass(frozen=True)
class Imported:
    """A floor plan from a drawing.

    Parameters
    ----------
    plan : FloorPlan
        Checked as any plan is.
    drawing : Drawing
        What was drawn, and the report.
    """

    plan: FloorPlan
    drawing: Drawing


def import_floorplan(
    path: Path, options: ImportOptions | None = None, meshes: Sequence[Path] = ()
) -> Imported:
    """Read a drawing and make a floor plan of it.

    Parameters
    ----------
    path : Path
        The file.
    options : ImportOptions, optional
        How to read it.
    meshes : sequence of Path
        PLY files that a Mitsuba scene may use, or folders of them.

    Raises
    ------
    FileFormatError
        If the file cannot be read as what its suffix says, or holds no walls.
    InputError
        If there is nowhere to walk or the plan is not valid otherwise; the message says what of the file
        was left out.
    """
    options = ImportOptions() if options is None else options
    path = Path(path)
    report = ImportReport()
    try:
        drawing = read_drawing(path, options, meshes)
        report = drawing.report
        plan = floorplan_of(drawing, path.stem or "plan", options)
    except InputError as error:
        left_out = report.left_out()
        text = f"{error}; left out: {left_out}" if left_out else str(error)
        raise type(error)(text if text.startswith(str(path)) else f"{path}: {text}") from error
    return Imported(plan, drawing)


def read_drawing(path: Path, options: ImportOptions, meshes: Sequence[Path] = ()) -> Drawing:
    """Read a file by its suffix; raises as :func:`import_floorplan`."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES and not is_imdf(path):
        raise FileFormatError(
            f"expected a name that ends in {', '.join(SUFFIXES)}, got {suffix or 'no suffix'!r}"
        )
    if meshes and suffix != ".xml":
        raise FileFormatError(f"expected meshes with a Mitsuba scene (.xml) alone, got them with {suffix}")
    if is_imdf(path):
        return read_imdf(path, options)
    data = _read(path)
    if suffix == ".dxf":
        return read_dxf(data, options)
    if suffix == ".osm":
        return read_osm(data, options)
    if suffix == ".ifc":
        return read_ifc(data, options)
    if suffix in MODELS:
        return read_model(data, suffix, options)
    if suffix == ".ply":
        return read_ply(data, path.stem, options)
    if suffix == ".xml":
        return read_mitsuba(data, options, {mesh.name: _read(mesh) for mesh in _meshes(meshes)})
    return read_geojson(data, options)


def _meshes(given: Sequence[Path]) -> Iterator[Path]:
    """PLY files that were given, or lie in folders that were given."""
    for path in given:
        if not path.is_dir():
            yield path
            continue
        inside = sorted(path.rglob("*.ply"))
        if not inside:
            raise FileFormatError(f"{path}: expected a folder with .ply files, there is none in it")
        yield from inside


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return require_size(stream.read(2**27))
    except OSError as error:
        raise FileFormatError(f"{path}: expected a file, could not read it: {error.strerror}") from error


def floorplan_of(drawing: Drawing, name: str, options: ImportOptions) -> FloorPlan:
    """A floor plan of a drawing: collapsed, joined, moved near the origin, and inhabited.

    Raises
    ------
    InputError
        If there is nowhere to walk, the walls are too many, or the plan is not valid otherwise.
    """
    report = drawing.report
    lines, (dx, dy) = _near(drawing)
    lines = join_ends(collapse(lines, options.thickest_m, report), report)
    if not 0 < len(lines) <= _MOST_WALLS:
        raise InputError(
            f"expected 1 to {_MOST_WALLS} walls, got {len(lines)}: leave layers out (--layer NAME=ignore), "
            "or import a part of the drawing"
        )
    walls, repairs = sound_walls([_wall(line, number) for number, line in enumerate(lines, 1)])
    report.notes += (
        repairs.lines() if len(repairs.lines()) <= _MOST_TOLD else [f"{len(repairs.overlaps)} overlaps"]
    )
    start, end = (np.array([getattr(wall, side) for wall in walls]) for side in ("from_m", "to_m"))
    thickness = np.array([wall.thickness_m for wall in walls])
    report.notes.append(f"{len(walls)} walls of {sum(line.length_m for line in lines):.1f} m in all")
    width, depth = np.ptp(np.vstack([start, end]), axis=0)
    doubt = questioned((float(width), float(depth)), 1.0, options.unit or "of the file")
    if doubt and not any("unit" in warning for warning in report.warnings):
        report.warnings.append(doubt)
    given = options.walk_m or tuple((x - dx, y - dy) for x, y in drawing.track_m)
    free = _drawn_space(drawing, (dx, dy))
    if free is None and (len(given) < 2 or not (drawing.anchors_m or options.anchors_m)):
        space = main_space(start, end, thickness, options.space)
        free = space.free
        told = f"{space.area_m2:.1f} m2 {space.kind}, {space.share:.0%} of all that is {space.kind}"
        report.notes.append(f"walkable space: {told}")
        if space.share < _SMALL_SHARE:
            report.warnings.append(f"the walkable space is small: {told}; are there walls across the doors?")
    walk = _given_walk(list(given)) if len(given) > 1 else plan_walk(start, end, thickness, free=free)
    if len(given) < 2:
        report.notes.append(f"no track in the file: one of {len(walk.waypoints_m)} way-points was placed")
    height = max(wall.height_m for wall in walls)
    hung = round(min(2.5, 0.8 * height), 3)
    places = [(label, (x - dx, y - dy, z)) for label, (x, y, z) in drawing.anchors_m]
    if options.anchors_m:
        places = [(f"pa{number}", place) for number, place in enumerate(options.anchors_m, 1)]
    if not places:
        found = place_anchors(start, end, thickness, np.array(_track_of(walk)), free=free)
        places = [(f"pa{number}", (float(x), float(y), hung)) for number, (x, y) in enumerate(found, 1)]
        report.notes.append(f"no anchors in the file: {len(places)} were placed")
    data: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": name[:100],
        "walls": [wall.model_dump() for wall in walls],
        "anchors": [
            {"name": label, "position_m": (round(x, 6), round(y, 6), z if z > 0 else hung)}
            for label, (x, y, z) in places
        ],
        "agent": {
            "waypoints_m": walk.waypoints_m,
            "height_m": round(min(1.5, 0.5 * height), 3),
            "step_m": walk.step_m,
            "speed_m_s": walk.step_m,
            "epochs": walk.epochs,
            "smoothing_m": walk.smoothing_m,
        },
        "radio": {"timing_jitter_s": 1e-10},
        **{slab: {"material": m} for slab in ("floor", "ceiling") if (m := getattr(drawing, slab))},
        **_georeference(drawing, (dx, dy)),
    }
    return parse_floorplan(data, source=name)


def _georeference(drawing: Drawing, shift: Point) -> dict[str, Any]:
    """Where the plan's origin is in the coordinates of the file, if it moved or the file says where it is."""
    if drawing.georeference is not None:
        crs, (x, y) = drawing.georeference
        return {
            "georeference": {
                "crs": crs,
                "origin": (x, y) if shift == (0.0, 0.0) else (x + shift[0], y + shift[1]),
            }
        }
    return {} if shift == (0.0, 0.0) else {"georeference": {"origin": shift}}


def _drawn_space(drawing: Drawing, shift: Point) -> shapely.Geometry | None:
    """What the file draws as walkable, as an area; None if it draws nothing."""
    rings = [np.array(ring) - shift for ring in drawing.space_m if len(ring) > 2]
    if not rings:
        return None
    areas = shapely.union_all(
        shapely.make_valid(shapely.polygons([shapely.linearrings(ring) for ring in rings]))
    )
    parts = [part for part in shapely.get_parts(areas) if part.geom_type == "Polygon"]
    return max(parts, key=shapely.area) if parts else None


def _near(drawing: Drawing) -> tuple[list[Line], tuple[float, float]]:
    """Lines moved near the origin if they lie far from it, and by how much."""
    ends = np.array([end for line in drawing.lines for end in (line.start_m, line.end_m)])
    if not len(ends) or np.abs(ends).max() <= _FAR_M:
        return drawing.lines, (0.0, 0.0)
    dx, dy = (float(value) for value in np.floor(ends.min(axis=0)))
    drawing.report.notes.append(f"moved by ({-dx:g}, {-dy:g}) m to the origin")
    moved = [
        replace(
            line,
            start_m=(line.start_m[0] - dx, line.start_m[1] - dy),
            end_m=(line.end_m[0] - dx, line.end_m[1] - dy),
        )
        for line in drawing.lines
    ]
    return moved, (dx, dy)


def _wall(line: Line, number: int) -> Wall:
    return Wall(
        name=f"{line.source[:80]}-{number}",
        from_m=line.start_m,
        to_m=line.end_m,
        height_m=line.height_m,
        material=line.material,
        thickness_m=line.thickness_m,
    )


def _given_walk(track: list[tuple[float, float]]) -> Walk:
    """A drawn track, walked in half-metre steps or, if it is short, in sixty."""
    points = [point for point, before in zip(track, [None, *track], strict=False) if point != before]
    length = float(np.linalg.norm(np.diff(np.array(points), axis=0), axis=1).sum())
    step = 0.5 if length > 30.0 else round(length / 60, 4)
    if step <= 0:
        raise InputError(f"track: expected a line at least a centimetre long, got {length:g} m")
    return Walk(tuple(points), step, int(length / step) + 1, smoothing_m=0.0)


def _track_of(walk: Walk) -> list[tuple[float, float]]:
    from raytrace.plan.trajectory import smoothed_track

    points = smoothed_track(walk.waypoints_m, walk.smoothing_m, walk.step_m, walk.epochs)
    return [(float(x), float(y)) for x, y in points]
