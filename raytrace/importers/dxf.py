"""DXF drawings: layers to materials, blocks unfolded, units from the header.

Lines, polylines, arcs, circles, ellipses and splines of the model space are walls if
their layer has a material; a line's DXF thickness (its extrusion) is its height. Points
on a layer named like ``anchor`` are anchors, a polyline on one named like ``track`` is
the agent's. References to other drawings are reported and never followed.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from estimator.errors import FileFormatError
from raytrace.importers.drawing import (
    MOST_LINES,
    Drawing,
    Line,
    require_finite,
    require_package,
    require_size,
)
from raytrace.importers.options import IGNORE, UNITS_M, ImportOptions

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document
    from ezdxf.entities import DXFEntity, Insert

__all__ = ["read_dxf"]

# $INSUNITS of the header.
_UNITS = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m", 7: "km", 10: "yd", 14: "dm"}
_CURVES = frozenset(
    ["LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE"]  # what make_path understands
)
_DEEPEST = 16
_MOST_ENTITIES = 200_000
_SAGITTA_M = 0.02
_ANCHOR, _TRACK = re.compile(r"anchor|\bpa\b", re.IGNORECASE), re.compile(r"track|trajectory", re.IGNORECASE)


def read_dxf(data: bytes, options: ImportOptions) -> Drawing:
    """Read a DXF drawing (text or binary).

    Parameters
    ----------
    data : bytes
        Contents of the file.
    options : ImportOptions
        How to read it.

    Raises
    ------
    FileFormatError
        If it is no DXF, has no unit (and ``options.unit`` gives none), nests blocks in
        themselves, is absurdly large, or holds no wall.
    """
    require_size(data)
    require_package("ezdxf")
    document = _document(data)
    drawing = Drawing()
    scale = _scale(document, options, drawing)
    hidden = {layer.dxf.name.lower() for layer in document.layers if layer.is_off() or layer.is_frozen()}
    unknown: Counter[str] = Counter()
    for entity, layer in _unfolded(document, drawing):
        if layer.lower() in hidden:
            drawing.report.dropped[f"{entity.dxftype()} on hidden layer {layer}"] += 1
        elif _ANCHOR.search(layer):
            _take_anchor(entity, layer, scale, drawing)
        elif _TRACK.search(layer) and entity.dxftype() in _CURVES:
            drawing.track_m = [(x * scale, y * scale) for x, y in _points(entity, scale)]
            drawing.report.kept[f"{entity.dxftype()} as track"] += 1
        else:
            material = options.material_of(layer)
            if material is None:
                unknown[layer] += 1
                drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, which no material fits"] += 1
            elif material == IGNORE:
                drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, ignored"] += 1
            elif entity.dxftype() not in _CURVES:
                drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, no line"] += 1
            else:
                _take_wall(entity, layer, material, scale, options, drawing)
    if not drawing.lines:
        seen = ", ".join(f"{name!r} ({count})" for name, count in unknown.most_common(8)) or "none"
        raise FileFormatError(
            f"expected walls on layers that a material fits, got none; layers that nothing fits: {seen}"
        )
    return drawing


def _document(data: bytes) -> Document:
    """Parse the file; whatever ezdxf finds wrong is one error."""
    import ezdxf
    from ezdxf.document import Drawing as Document
    from ezdxf.filemanagement import dxf_stream_info
    from ezdxf.lldxf.tagger import binary_tags_loader

    try:
        if data.startswith(b"AutoCAD Binary DXF"):
            return Document.load(binary_tags_loader(data))
        head = data[:4096].lstrip()
        if not re.match(rb"(999\s.*\r?\n)*\s*0\s*\r?\n\s*SECTION", head):
            raise FileFormatError(f"expected a DXF file that starts with a SECTION, got {head[:20]!r}")
        text = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", errors="surrogateescape")
        encoding = dxf_stream_info(text).encoding
        return ezdxf.read(io.StringIO(data.decode(encoding, errors="surrogateescape")))
    except FileFormatError:
        raise
    except Exception as error:  # ezdxf raises errors of many kinds on damaged files
        raise FileFormatError(f"expected a DXF file, could not read it: {_brief(error)}") from error


def _brief(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:160]


def _scale(document: Document, options: ImportOptions, drawing: Drawing) -> float:
    """Metres per unit of the drawing."""
    header = document.header.get("$INSUNITS", 0)
    unit = options.unit or _UNITS.get(header)
    if unit is None:
        what = "no unit (0)" if not header else f"unit {header}"
        raise FileFormatError(
            f"$INSUNITS: expected a unit among {', '.join(_UNITS.values())}, got {what}; give one"
        )
    source = "as told" if options.unit else "from the header"
    drawing.report.notes.append(f"unit {unit}, {source}")
    return UNITS_M[unit]


def _unfolded(document: Document, drawing: Drawing) -> Iterator[tuple[DXFEntity, str]]:
    """Entities of the model space with the layer that counts, blocks unfolded."""
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
        raise FileFormatError(f"block {name!r}: could not be placed: {_brief(error)}") from error
    drawing.report.kept["block unfolded"] += 1
    return parts


def _points(entity: DXFEntity, scale: float) -> list[tuple[float, float]]:
    """A curve as points of a polyline, in units of the drawing."""
    from ezdxf.path import make_path

    try:
        path = make_path(entity)
        points = list(path.flattening(_SAGITTA_M / scale, segments=2))
    except Exception as error:  # e.g. a spline without knots
        raise FileFormatError(f"{entity.dxftype()}: could not be drawn: {_brief(error)}") from error
    if len(points) > MOST_LINES:
        raise FileFormatError(f"{entity.dxftype()}: expected at most {MOST_LINES} points, got {len(points)}")
    return [(float(point.x), float(point.y)) for point in points]


def _take_wall(
    entity: DXFEntity, layer: str, material: str, scale: float, options: ImportOptions, drawing: Drawing
) -> None:
    if entity.dxftype() == "POLYLINE" and (entity.is_poly_face_mesh or entity.is_polygon_mesh):
        drawing.report.dropped[f"POLYLINE on layer {layer}, a mesh"] += 1
        return
    extrusion = float(entity.dxf.get("thickness", 0.0)) * scale
    height = abs(extrusion) if extrusion and math.isfinite(extrusion) else options.height_m
    points = _points(entity, scale)
    ends = [(x * scale, y * scale) for x, y in points]
    taken = 0
    for start, end in itertools.pairwise(ends):
        require_finite((*start, *end), f"{entity.dxftype()} on layer {layer}")
        if start != end:
            drawing.add(Line(start, end, material, height, options.thickness_m, layer))
            taken += 1
    if taken:
        drawing.report.kept[f"{entity.dxftype()} on layer {layer} as {material}"] += 1
    else:
        drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, without length"] += 1


def _take_anchor(entity: DXFEntity, layer: str, scale: float, drawing: Drawing) -> None:
    if entity.dxftype() == "POINT":
        place = entity.dxf.location
    elif entity.dxftype() == "CIRCLE":
        place = entity.ocs().to_wcs(entity.dxf.center)
    else:
        drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, no point"] += 1
        return
    x, y, z = (float(value) * scale for value in place)
    require_finite((x, y, z), f"{entity.dxftype()} on layer {layer}")
    drawing.anchors_m.append((f"pa{len(drawing.anchors_m) + 1}", (x, y, z if z > 0 else np.nan)))
    drawing.report.kept[f"{entity.dxftype()} as anchor"] += 1
