"""DXF drawings: layers to materials, blocks unfolded, units from the header or the walls.

Lines, polylines, multi-lines, arcs, circles, ellipses, splines and solids of the model space are
walls if their layer has a material, hatches if the user asks for them; a line's DXF thickness (its
extrusion) is its height. Arcs that are the swing of a door mark an opening. Points on a layer named
like ``anchor`` are anchors, a polyline on one named like ``track`` is the agent's, and one named like
``walkable`` says where it may walk. References to other drawings are reported and never followed.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from estimator.errors import FileFormatError, InputError
from raytrace.importers.drawing import MOST_LINES, Drawing, require_package, require_size
from raytrace.importers.dxf_entities import (
    CURVES,
    Collector,
    is_door,
    is_quarter,
    straight_pieces,
    unfolded,
)
from raytrace.importers.options import IGNORE, ImportOptions
from raytrace.importers.units import Measures, Unit, choose_unit

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document
    from ezdxf.entities import DXFEntity

__all__ = ["read_dxf"]

# $INSUNITS of the header.
_UNITS = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m", 7: "km", 10: "yd", 14: "dm"}
_SPACE = re.compile(r"walkable", re.IGNORECASE)
_ANCHOR, _TRACK = re.compile(r"anchor|\bpa\b", re.IGNORECASE), re.compile(r"track|trajectory", re.IGNORECASE)


def read_dxf(data: bytes, options: ImportOptions) -> Drawing:
    """Read a DXF drawing (text of either line end, or binary; releases from R10 on).

    Parameters
    ----------
    data : bytes
        Contents of the file.
    options : ImportOptions
        How to read it.

    Raises
    ------
    FileFormatError
        If it is no DXF, has no unit (``options.unit`` gives none, and the walls do not tell), nests
        blocks in themselves, is absurdly large, or holds no wall.
    """
    require_size(data)
    require_package("ezdxf")
    drawing = Drawing()
    document = _document(data)
    hidden = {layer.dxf.name.lower() for layer in document.layers if layer.is_off() or layer.is_frozen()}
    entities, walls = _entities(document, options, drawing)
    unit = _unit(
        document, [(e, layer) for e, layer in entities if layer.lower() not in hidden], walls, options
    )
    drawing.report.notes.append(unit.note)
    drawing.report.warnings += [unit.warning] if unit.warning else []
    taken = Collector(drawing, unit.metres, options)
    unknown: Counter[str] = Counter()
    for entity, layer in entities:
        if layer.lower() in hidden:
            drawing.report.dropped[f"{entity.dxftype()} on hidden layer {layer}"] += 1
        elif _ANCHOR.search(layer):
            taken.anchor(entity, layer)
        elif _TRACK.search(layer) and entity.dxftype() in CURVES:
            drawing.track_m = taken.points(entity)
            drawing.report.kept[f"{entity.dxftype()} as track"] += 1
        elif _SPACE.search(layer) and entity.dxftype() in CURVES:
            drawing.space_m.append(taken.points(entity))
            drawing.report.kept[f"{entity.dxftype()} as walkable space"] += 1
        else:
            material = options.material_of(layer)
            if material is None:
                unknown[layer] += 1
                drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, which no material fits"] += 1
            elif material == IGNORE:
                taken.door(entity, layer)
                drawing.report.dropped[f"{entity.dxftype()} on layer {layer}, ignored"] += 1
            else:
                taken.wall(entity, layer, material)
    taken.open_doors()
    if not drawing.lines:
        seen = ", ".join(f"{name!r} ({count})" for name, count in unknown.most_common(8)) or "none"
        raise FileFormatError(
            f"expected walls on layers that a material fits, got none; layers that nothing fits: {seen}"
        )
    return drawing


def _entities(
    document: Document, options: ImportOptions, drawing: Drawing
) -> tuple[list[tuple[DXFEntity, str]], set[str]]:
    """All entities with the layer that counts, and the layers of walls; InputError beyond a plan's size."""
    entities, walls, lines = [], set[str](), 0
    for entity, layer in unfolded(document, drawing):
        entities.append((entity, layer))
        if layer in walls or options.material_of(layer) not in (None, IGNORE):
            walls.add(layer)
            lines += entity.dxftype() in CURVES
        if lines > MOST_LINES:
            raise InputError(f"expected at most {MOST_LINES} lines of walls, got more (at {layer!r})")
    return entities, walls


def _document(data: bytes) -> Document:
    """Parse the file; whatever ezdxf finds wrong is one error."""
    import ezdxf
    from ezdxf.document import Drawing as Document
    from ezdxf.filemanagement import dxf_stream_info
    from ezdxf.lldxf.tagger import binary_tags_loader

    try:
        if data.startswith(b"AutoCAD Binary DXF"):
            return Document.load(binary_tags_loader(data))
        head = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
        if not re.match(rb"(999[ \t]*(\r\n|\r|\n)[^\r\n]*(\r\n|\r|\n))*\s*0\s*(\r\n|\r|\n)\s*SECTION", head):
            raise FileFormatError(f"expected a DXF file that starts with a SECTION, got {head[:20]!r}")
        stream = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", errors="surrogateescape")
        encoding = dxf_stream_info(stream).encoding.replace("utf8", "utf-8").replace("utf-8", "utf-8-sig")
        text = data.decode(encoding, errors="surrogateescape")
        return ezdxf.read(io.StringIO(text, newline=None))  # either line end becomes one
    except FileFormatError:
        raise
    except Exception as error:  # ezdxf raises errors of many kinds on damaged files
        raise FileFormatError(f"expected a DXF file, could not read it: {_brief(error)}") from error


def _brief(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:160]


def _unit(
    document: Document, entities: list[tuple[DXFEntity, str]], walls: set[str], options: ImportOptions
) -> Unit:
    """The unit that the user, the header or the walls tell."""
    header = document.header.get("$INSUNITS", 0)
    came = "no unit (0)" if not header else f"unit {header}"
    drawn = [straight_pieces(entity) for entity, layer in entities if layer in walls]
    swings = [
        float(entity.dxf.radius)
        for entity, layer in entities
        if entity.dxftype() == "ARC" and (layer in walls or is_door(layer)) and is_quarter(entity)
    ]
    points = np.concatenate([piece.reshape(-1, 2) for piece in drawn] or [np.zeros((0, 2))])
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused where it is taken
        lengths = [np.linalg.norm(piece[:, 1] - piece[:, 0], axis=1) for piece in drawn]
    finite = points[np.isfinite(points).all(axis=1)]
    extent = np.ptp(finite, axis=0) if len(finite) else np.zeros(2)
    length = np.concatenate(lengths) if lengths else np.zeros(0)
    measures = Measures(
        length[np.isfinite(length) & (length > 0)], (float(extent[0]), float(extent[1])), np.array(swings)
    )
    if not len(finite) and header not in _UNITS and options.unit is None:
        raise FileFormatError(f"expected walls on layers that a material fits, got none, and {came}")
    return choose_unit(measures, _UNITS.get(header), options.unit, f"$INSUNITS: {came}")
