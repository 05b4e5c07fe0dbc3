"""Entities of DXF drawings: blocks unfolded, curves as polylines, walls, doors and points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimator.errors import FileFormatError
from raytrace.importers.drawing import MOST_LINES, Drawing, Line, Point, require_finite
from raytrace.importers.openings import Swing, cut_openings, swing_openings
from raytrace.importers.options import ImportOptions, words_of

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document
    from ezdxf.entities import DXFEntity, Insert

__all__ = ["CURVES", "Collector", "is_door", "is_quarter", "straight_pieces", "unfolded"]

# What ezdxf makes a path of; then what is made of several lines, and what fills an area.
CURVES = frozenset(
    ["LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "HELIX"]
    + ["SOLID", "TRACE", "3DFACE"]
)
_COMPOUND = frozenset(["MLINE"])
_FILLED = frozenset(["HATCH", "MPOLYGON"])
_DOOR = frozenset(("door", "tuer", "tür", "porte", "puerta", "porta", "opening"))
_DEEPEST = 16
_MOST_ENTITIES = 200_000
_SAGITTA_M = 0.02
# A door is drawn open by a quarter turn, more or less.
_QUARTER_RAD = (np.deg2rad(60.0), np.deg2rad(120.0))


def is_door(layer: str) -> bool:
    """Whether a layer is named for doors."""
    return bool(words_of(layer) & _DOOR)


def is_quarter(arc: DXFEntity) -> bool:
    """Whether an arc turns by about a quarter, as the swing of a door does."""
    return bool(_QUARTER_RAD[0] <= _turn(arc) <= _QUARTER_RAD[1])


def _turn(arc: DXFEntity) -> float:
    """Angle of an arc, radians; NaN if the file has none."""
    return math.radians((float(arc.dxf.end_angle) - float(arc.dxf.start_angle)) % 360.0)


def straight_pieces(entity: DXFEntity) -> NDArray[np.float64]:
    """Straight pieces of a line or polyline without bulges, shape (n, 2, 2), in units of the drawing."""
    kind = entity.dxftype()
    if kind == "LINE":
        points = [entity.dxf.start, entity.dxf.end]
    elif kind == "LWPOLYLINE" and not entity.has_arc:
        points = [(x, y) for x, y in entity.get_points("xy")]
        points += points[:1] if entity.closed else []
    elif kind == "POLYLINE" and entity.is_2d_polyline and not entity.has_arc:
        points = [vertex.dxf.location for vertex in entity.vertices]
    else:
        return np.zeros((0, 2, 2))
    flat = np.array([(point[0], point[1]) for point in points], dtype=np.float64).reshape(-1, 2)
    return np.stack([flat[:-1], flat[1:]], axis=1)


def unfolded(document: Document, drawing: Drawing) -> Iterator[tuple[DXFEntity, str]]:
    """Entities of the model space with the layer that counts, blocks unfolded.

    Raises
    ------
    FileFormatError
        If blocks hold themselves, or are absurdly many.
    """
    stack: list[tuple[DXFEntity, str, tuple[str, ...]]]
    stack = [(entity, "", ()) for entity in reversed(list(document.modelspace()))]
    count = 0
    while stack:
        entity, parent, inside = stack.pop()
        count += 1
        if count > _MOST_ENTITIES:
            raise FileFormatError(
                f"expected at most {_MOST_ENTITIES} entities with blocks unfolded, got more"
            )
        own = str(entity.dxf.get("layer", "0"))
        layer = parent if own == "0" and parent else own
        if entity.dxftype() != "INSERT":
            yield entity, layer
            continue
        name = str(entity.dxf.get("name", ""))
        if name.lower() in inside or len(inside) >= _DEEPEST:
            raise FileFormatError(f"block {name!r}: expected blocks that do not hold themselves, it does")
        parts = _parts(entity, name, document, drawing)
        stack += [(part, layer, (*inside, name.lower())) for part in reversed(parts)]


def _parts(insert: Insert, name: str, document: Document, drawing: Drawing) -> list[DXFEntity]:
    """Entities of one insertion of a block, placed, rotated and scaled."""
    block = document.blocks.get(name) if name else None
    if block is None:
        drawing.report.dropped[f"INSERT of block {name!r}, which is not there"] += 1
        return []
    if block.block is not None and (block.block.is_xref or block.block.is_xref_overlay):
        drawing.report.dropped[f"INSERT of another file ({name}), not followed"] += 1
        return []
    copies = max(insert.mcount, 1)
    if copies * max(len(block), 1) > _MOST_ENTITIES:
        raise FileFormatError(
            f"block {name!r}: expected at most {_MOST_ENTITIES} entities, got {copies} copies"
        )
    try:
        inserts = list(insert.multi_insert()) if copies > 1 else [insert]
        parts = [part for one in inserts for part in one.virtual_entities()]
    except Exception as error:  # a singular scale, damaged attributes
        raise FileFormatError(
            f"block {name!r}: could not be placed: {type(error).__name__}: {error}"
        ) from error
    drawing.report.kept["block unfolded"] += 1
    return parts


class Collector:
    """Takes entities into a drawing, in metres.

    Parameters
    ----------
    drawing : Drawing
        What is collected.
    scale : float
        Metres per unit of the file.
    options : ImportOptions
        Heights, thicknesses, whether hatches are walls.
    """

    def __init__(self, drawing: Drawing, scale: float, options: ImportOptions) -> None:
        self.drawing, self.scale, self.options = drawing, scale, options
        self._swings: list[Swing] = []
        self._leaves: list[Line] = []

    def points(self, entity: DXFEntity) -> list[Point]:
        """A curve as points of a polyline, metres; raises FileFormatError if it cannot be drawn."""
        from ezdxf.path import make_path

        try:
            path = make_path(entity)
            points = list(path.flattening(_SAGITTA_M / self.scale, segments=2))
        except Exception as error:  # e.g. a spline without knots
            raise _undrawn(entity, error) from error
        if len(points) > MOST_LINES:
            raise FileFormatError(
                f"{entity.dxftype()}: expected at most {MOST_LINES} points, got {len(points)}"
            )
        return [(float(point.x) * self.scale, float(point.y) * self.scale) for point in points]

    def wall(self, entity: DXFEntity, layer: str, material: str) -> None:
        """Take a wall, or a door that is drawn on a layer of walls."""
        kind, report = entity.dxftype(), self.drawing.report
        if kind in _FILLED and not self.options.hatches:
            report.dropped[f"{kind} on layer {layer}, a filling (--hatches takes its outline)"] += 1
        elif kind == "POLYLINE" and (entity.is_poly_face_mesh or entity.is_polygon_mesh):
            report.dropped[f"POLYLINE on layer {layer}, a mesh"] += 1
        elif kind == "ARC" and self._swing(entity):
            report.dropped[f"ARC on layer {layer}, the swing of a door"] += 1
        elif kind not in CURVES | _COMPOUND | _FILLED:
            report.dropped[f"{kind} on layer {layer}, no line"] += 1
        else:
            taken = [self._lines(curve, entity, layer, material) for curve in self._curves(entity)]
            if any(taken):
                report.kept[f"{kind} on layer {layer} as {material}"] += 1
            else:
                report.dropped[f"{kind} on layer {layer}, without length"] += 1

    def door(self, entity: DXFEntity, layer: str) -> None:
        """Remember what a layer of doors says about where they are."""
        if not is_door(layer):
            return
        if entity.dxftype() == "ARC":
            self._swing(entity)
        for start, end in straight_pieces(entity) * self.scale:
            if np.isfinite([start, end]).all() and len(self._leaves) < MOST_LINES:
                ends = ((float(start[0]), float(start[1])), (float(end[0]), float(end[1])))
                self._leaves.append(Line(*ends, "wood", self.options.height_m, 0.05, layer))

    def open_doors(self) -> None:
        """Take leaves out of the walls, and cut walls that were drawn through doors."""
        report = self.drawing.report
        lines, openings = swing_openings(self._swings, self.drawing.lines, self._leaves, report)
        self.drawing.lines = cut_openings(lines, openings, self.options.thickest_m, report)
        if self._swings:
            report.notes.append(f"{len(self._swings)} swings of doors recognised")

    def anchor(self, entity: DXFEntity, layer: str) -> None:
        """Take an anchor: a point, or the centre of a circle."""
        if entity.dxftype() == "POINT":
            place = entity.dxf.location
        elif entity.dxftype() == "CIRCLE":
            place = entity.ocs().to_wcs(entity.dxf.center)
        else:
            self.drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, no point"] += 1
            return
        x, y, z = (float(value) * self.scale for value in place)
        require_finite((x, y, z), f"{entity.dxftype()} on layer {layer}")
        name = f"pa{len(self.drawing.anchors_m) + 1}"
        self.drawing.anchors_m.append((name, (x, y, z if z > 0 else np.nan)))
        self.drawing.report.kept[f"{entity.dxftype()} as anchor"] += 1

    def _swing(self, arc: DXFEntity) -> bool:
        """Remember an arc that is the swing of a door; whether it is one."""
        radius = float(arc.dxf.radius) * self.scale
        angles = (arc.dxf.start_angle, arc.dxf.end_angle)
        centre = arc.ocs().to_wcs(arc.dxf.center)
        hinge = (float(centre.x) * self.scale, float(centre.y) * self.scale)
        ends = [arc.ocs().to_wcs(point) for point in arc.vertices(angles)]
        (x0, y0), (x1, y1) = ((float(p.x) * self.scale, float(p.y) * self.scale) for p in ends)
        swing = Swing(hinge, radius, ((x0, y0), (x1, y1)))
        if not (is_quarter(arc) and swing.is_door):
            return False
        self._swings.append(swing)
        return True

    def _curves(self, entity: DXFEntity) -> Iterable[list[Point]]:
        """The polylines that an entity draws."""
        kind = entity.dxftype()
        if kind in _COMPOUND:
            try:
                parts = list(entity.virtual_entities())
            except Exception as error:
                raise _undrawn(entity, error) from error
            return [self.points(part) for part in parts if part.dxftype() in CURVES]
        if kind in _FILLED:
            return self._outlines(entity)
        points = self.points(entity)
        return [points + points[:1] if kind in ("SOLID", "TRACE", "3DFACE") else points]

    def _outlines(self, hatch: DXFEntity) -> list[list[Point]]:
        from ezdxf.path import from_hatch

        try:
            paths = [list(path.flattening(_SAGITTA_M / self.scale)) for path in from_hatch(hatch)]
        except Exception as error:
            raise _undrawn(hatch, error) from error
        return [
            [(float(p.x) * self.scale, float(p.y) * self.scale) for p in [*path, path[0]]] for path in paths
        ]

    def _lines(self, points: list[Point], entity: DXFEntity, layer: str, material: str) -> int:
        """Add the pieces of a polyline; how many have a length."""
        options, taken = self.options, 0
        extrusion = float(entity.dxf.thickness) * self.scale if entity.dxf.hasattr("thickness") else 0.0
        height = abs(extrusion) if extrusion and math.isfinite(extrusion) else options.height_m
        for start, end in itertools.pairwise(points):
            require_finite((*start, *end), f"{entity.dxftype()} on layer {layer}")
            if start != end:
                self.drawing.add(Line(start, end, material, height, options.thickness_m, layer))
                taken += 1
        return taken


def _undrawn(entity: DXFEntity, error: Exception) -> FileFormatError:
    return FileFormatError(f"{entity.dxftype()}: could not be drawn: {type(error).__name__}: {error}"[:200])
