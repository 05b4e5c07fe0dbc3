"""IFC: a storey of a building model, cut at eye height.

Walls, columns, plates, members and what else is built give the lines where they cross the cut, as high as
they reach, but no higher than the storey; windows a pane of glass along their middle; doors open what
they are in. A large slab at the storey's floor is the plan's floor, one over it the ceiling. Materials
follow from their names in the model, then from those of the elements and their classes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from raytrace.importers.drawing import Drawing, Line, Opening, Point, require_size
from raytrace.importers.ifc_model import IfcElement, IfcModel, Storey, load_model
from raytrace.importers.mesh import take_walls
from raytrace.importers.openings import cut_openings
from raytrace.importers.options import IGNORE, ImportOptions

__all__ = ["drawing_of_model", "levels_in", "read_ifc"]

Array = NDArray[np.float64]

# What its class tells of an element's material where no name does.
_CLASSES = {"IfcPlate": "glass", "IfcMember": "metal"}
_SLABS = ("IfcSlab", "IfcCovering")
# Two panes of 4 mm: what a window is to a wave, whatever the depth of its frame.
_GLAZING_M = 0.008
# A pane is parallel to its wall within this.
_PARALLEL = np.sin(np.deg2rad(2.0))
# Storeys nearer than this are two heights of one (a raised floor, a split level), metres.
_LOWEST_STOREY_M = 1.8
# A slab whose face is this near a storey's floor belongs to it, metres.
_NEAR_FLOOR_M = 0.5
_SLAB_SHARE = 0.25  # of the plan's bounding box, for a floor or a ceiling


@dataclass(frozen=True)
class _Section:
    """Where a storey is cut: its floor, and the height that no wall of it exceeds, metres."""

    floor_m: float
    height_m: float


def read_ifc(data: bytes, options: ImportOptions) -> Drawing:
    """Read one storey of an IFC file.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    options : ImportOptions
        How to read it; ``level`` is the name of a storey, and ``materials`` are asked for classes
        (``IfcWall``), names of elements and of materials. Lengths are those of the file, whatever ``unit``.

    Raises
    ------
    FileFormatError
        If it is no IFC, has several storeys with walls and none was chosen, or none with walls.
    BackendError
        If IfcOpenShell is not installed.
    """
    return drawing_of_model(load_model(require_size(data)), options)


def levels_in(data: bytes) -> list[str]:
    """Names of the storeys that have walls, from the lowest; raises as :func:`read_ifc`."""
    model = load_model(require_size(data))
    return [storey.name for storey in _storeys(model, ImportOptions().cut_m)]


def drawing_of_model(model: IfcModel, options: ImportOptions) -> Drawing:
    """A drawing of one storey of a model; raises as :func:`read_ifc`."""
    drawing = Drawing()
    report = drawing.report
    section = _section(model, options, drawing)
    report.notes.append(f"{model.schema}, cut {options.cut_m:g} m above the floor at {section.floor_m:g} m")
    drawing.georeference = model.georeference
    for kind, count in model.others.items():
        report.dropped[kind] += count
    walls = _straight_walls(model, options.thickest_m)
    for element in model.elements:
        _take(element, section, walls, options, drawing)
    if not drawing.lines:
        raise FileFormatError(
            f"expected walls {options.cut_m:g} m above the floor at {section.floor_m:g} m, got none"
        )
    _take_slabs(model, section, options, drawing)
    for name, (x, y, z) in model.antennas:
        if 0.0 < z - section.floor_m < section.height_m:
            drawing.anchors_m.append((name, (x, y, round(z - section.floor_m, 6))))
            report.kept["IfcCommunicationsAppliance as anchor"] += 1
    drawing.lines = cut_openings(drawing.lines, drawing.openings, options.thickest_m, report)
    report.kept, report.dropped = +report.kept, +report.dropped
    return drawing


def _storeys(model: IfcModel, cut_m: float) -> list[Storey]:
    """Storeys in which walls cross the cut."""
    spans = np.array(
        [
            (e.triangles[..., 2].min(), e.triangles[..., 2].max())
            for e in model.elements
            if e.kind == "IfcWall"
        ]
    ).reshape(-1, 2)
    return [
        storey
        for storey in model.storeys
        if np.any((spans[:, 0] < storey.elevation_m + cut_m) & (spans[:, 1] > storey.elevation_m + cut_m))
    ]


def _section(model: IfcModel, options: ImportOptions, drawing: Drawing) -> _Section:
    """Where to cut: the storey that was chosen, the only one, or the lowest point of a model without any."""
    if not model.elements:
        raise FileFormatError("expected walls with a shape, got none")
    storeys = _storeys(model, options.cut_m)
    names = [storey.name for storey in storeys]
    if options.level is None and len(storeys) > 1:
        raise FileFormatError(
            f"levels: expected one level, got {len(names)} ({', '.join(names[:12])}"
            f"{', ...' if len(names) > 12 else ''}); choose one with --level"
        )
    if options.level is not None and options.level not in names:
        raise FileFormatError(
            f"level: expected one of {', '.join(names) or 'none that the file states'}, got {options.level!r}"
        )
    if not storeys:
        low = min(float(element.triangles[..., 2].min()) for element in model.elements)
        return _Section(low, np.inf)
    storey = next(one for one in storeys if options.level in (None, one.name))
    above = [
        other.elevation_m - storey.elevation_m
        for other in model.storeys
        if other.elevation_m - storey.elevation_m > _LOWEST_STOREY_M
    ]
    drawing.report.notes.append(f"level {storey.name} of {', '.join(names)}")
    return _Section(storey.elevation_m, min(above, default=np.inf))


def _take(
    element: IfcElement,
    section: _Section,
    walls: list[tuple[Array, float]],
    options: ImportOptions,
    drawing: Drawing,
) -> None:
    """Lines of an element where the cut meets it."""
    report, kind = drawing.report, element.kind
    heights = element.triangles[..., 2] - section.floor_m
    top = round(min(float(heights.max()), section.height_m), 4)
    told, material = _material(element, options)
    if kind in _SLABS and told is None:
        return
    if not heights.min() < options.cut_m < heights.max():
        report.dropped[f"{kind} below or above the cut"] += 1
    elif material == IGNORE:
        report.dropped[f"{kind}, ignored"] += 1
    elif kind == "IfcDoor" and told is None:
        start, end = _in_wall(_middle(element.triangles)[0], walls)
        drawing.openings.append(Opening(start, end))
        report.kept["IfcDoor as opening"] += 1
    elif kind in ("IfcWindow", "IfcDoor"):
        start, end = _in_wall(_middle(element.triangles)[0], walls)
        drawing.add(Line(start, end, material, top, _GLAZING_M, kind))
        report.kept[f"{kind} as {material}"] += 1
    else:
        lowered = element.triangles - (0.0, 0.0, section.floor_m)
        take_walls(kind, lowered, material, options, drawing, top_m=top)


def _middle(triangles: Array) -> tuple[Array, float]:
    """Ends (2, 2) of the line along the middle of what a thing covers of the plan, and its width, metres."""
    outline = shapely.oriented_envelope(shapely.multipoints(triangles[..., :2].reshape(-1, 2)))
    corners = shapely.get_coordinates(outline)
    if len(corners) != 5:  # no area: a line
        return corners[[0, -1]], 0.0
    long = np.linalg.norm(corners[1] - corners[0]) >= np.linalg.norm(corners[2] - corners[1])
    corners = corners[:4] if long else np.roll(corners[:4], -1, axis=0)
    width = float(np.linalg.norm(corners[3] - corners[0]))
    return 0.5 * np.array([corners[0] + corners[3], corners[1] + corners[2]]), width


def _straight_walls(model: IfcModel, thickest_m: float) -> list[tuple[Array, float]]:
    """Middle line and width of the walls that are straight, as :func:`_middle`."""
    middles = (_middle(element.triangles) for element in model.elements if element.kind == "IfcWall")
    return [(line, width) for line, width in middles if width <= thickest_m]


def _in_wall(line: Array, walls: list[tuple[Array, float]]) -> tuple[Point, Point]:
    """Ends of a pane that is moved across to the middle of the wall in which it stands, if there is one."""
    for middle, width in walls:
        way = middle[1] - middle[0]
        length = float(np.linalg.norm(way))
        along, across = (line - middle[0]) @ way / length, _cross(way, line - middle[0]) / length
        level = abs(across[1] - across[0]) <= _PARALLEL * np.linalg.norm(line[1] - line[0])
        if level and np.all(np.abs(across) <= width) and 0.0 <= along.mean() <= length:
            line = middle[0] + along[:, None] * way / length
            break
    (x0, y0), (x1, y1) = line
    return (float(x0), float(y0)), (float(x1), float(y1))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[:, 1] - a[1] * b[:, 0])


def _material(element: IfcElement, options: ImportOptions) -> tuple[str | None, str]:
    """What the user says of an element, and the material that it has."""
    named = (element.kind, element.name, *element.materials)
    told = next((found for name in named if (found := options.told_of(name)) is not None), None)
    if told is not None:
        return told, told
    if element.kind == "IfcWindow":  # its named materials are those of its frame
        return None, "glass"
    guesses = (options.material_of(name) for name in (*element.materials, element.name))
    found = next((guess for guess in guesses if guess not in (None, IGNORE, options.material)), None)
    return None, found or _CLASSES.get(element.kind) or options.material or "concrete"


def _take_slabs(model: IfcModel, section: _Section, options: ImportOptions, drawing: Drawing) -> None:
    """Slabs that cover much of the plan, at the storey's floor and above its walls."""
    ends = np.array([end for line in drawing.lines for end in (line.start_m, line.end_m)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    area = float(np.prod(high - low))
    above = min(section.height_m, max(line.height_m for line in drawing.lines))
    covered: dict[tuple[str, str], float] = {}
    for element in model.elements:
        told, material = _material(element, options)
        if element.kind not in _SLABS or told is not None:
            continue
        bottom, top = np.array([element.triangles[..., 2].min(), element.triangles[..., 2].max()])
        x0, y0 = np.maximum(element.triangles[..., :2].min(axis=(0, 1)), low)
        x1, y1 = np.minimum(element.triangles[..., :2].max(axis=(0, 1)), high)
        inside = max(0.0, float(x1 - x0)) * max(0.0, float(y1 - y0))
        if abs(top - section.floor_m) < _NEAR_FLOOR_M:
            slab = "floor"
        elif abs(bottom - section.floor_m - above) < _NEAR_FLOOR_M:
            slab = "ceiling"
        else:
            continue
        covered[slab, material] = covered.get((slab, material), 0.0) + inside
        drawing.report.kept[f"{element.kind} as {slab} of {material}"] += 1
    for slab in ("floor", "ceiling"):
        mine = {material: size for (name, material), size in covered.items() if name == slab}
        if mine and sum(mine.values()) >= _SLAB_SHARE * area:
            setattr(drawing, slab, max(mine, key=lambda material: mine[material]))
