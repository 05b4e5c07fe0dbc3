"""Drawings as architects leave them, and what imports of them give."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezdxf

from raytrace.importers.convert import Imported, import_floorplan
from raytrace.importers.options import ImportOptions

INCH = 0.0254


def box(x0: float, y0: float, x1: float, y1: float, scale: float = 1.0) -> list[tuple[float, float]]:
    return [(x * scale, y * scale) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]


def flat(unit: float = INCH, header: int = 1) -> Any:
    """A flat of 12 m x 8 m: outer walls 0.3 m of double lines, a partition with a door, a turned column."""
    document = ezdxf.new()
    document.header["$INSUNITS"] = header
    space, scale = document.modelspace(), 1.0 / unit
    for name in ("A-WALL", "A-DOOR", "A-FURN", "A-GLAZ"):
        document.layers.add(name)
    wall = {"layer": "A-WALL"}
    space.add_lwpolyline(box(0, 0, 12, 8, scale), close=True, dxfattribs=wall)
    left = [(7, 0.3), (0.3, 0.3), (0.3, 7.7), (7, 7.7)]
    right = [(7.1, 0.3), (11.7, 0.3), (11.7, 7.7), (7.1, 7.7)]
    for points in (left, right):
        space.add_lwpolyline([(x * scale, y * scale) for x, y in points], dxfattribs=wall)
    for x0, y0, x1, y1 in (
        *((x, 0.3, x, 3.0) for x in (7.0, 7.1)),
        *((x, 4.0, x, 7.7) for x in (7.0, 7.1)),
        *((7.0, y, 7.1, y) for y in (3.0, 4.0)),
    ):
        space.add_line((x0 * scale, y0 * scale), (x1 * scale, y1 * scale), dxfattribs=wall)
    door = document.blocks.new("DOOR")
    door.add_line((0, 0), (-scale, 0), dxfattribs={"layer": "A-DOOR"})
    door.add_arc((0, 0), scale, 90, 180, dxfattribs={"layer": "A-DOOR"})
    space.add_blockref("DOOR", (7 * scale, 3 * scale), dxfattribs={"layer": "A-DOOR"})
    column = document.blocks.new("COLUMN")  # on layer 0: takes the layer of its insertion
    column.add_lwpolyline(box(-0.2, -0.2, 0.2, 0.2, scale), close=True)
    space.add_blockref("COLUMN", (3 * scale, 4 * scale), dxfattribs={**wall, "rotation": 30})
    space.add_line((4 * scale, 5 * scale), (5 * scale, 5 * scale), dxfattribs={"layer": "A-GLAZ"})
    space.add_text("kitchen", dxfattribs={"layer": "A-FURN"})
    return document


def contents(document: Any, binary: bool = False) -> bytes:
    if binary:
        stream = io.BytesIO()
        document.write(stream, fmt="bin")
        return stream.getvalue()
    text = io.StringIO()
    document.write(text)
    return text.getvalue().encode()


def imported(document: Any, folder: Path, **options: Any) -> Imported:
    path = folder / "flat.dxf"
    path.write_bytes(contents(document))
    return import_floorplan(path, ImportOptions(**options))


def ends(made: Imported) -> set[frozenset[tuple[float, float]]]:
    return {frozenset((round(x, 4), round(y, 4)) for x, y in (w.from_m, w.to_m)) for w in made.plan.walls}


def segment(x0: float, y0: float, x1: float, y1: float) -> frozenset[tuple[float, float]]:
    return frozenset([(x0, y0), (x1, y1)])


def altered(change: Callable[[Any], None]) -> bytes:
    document = flat(1.0, 6)
    change(document)
    return contents(document)


def only(*add: Callable[[Any], Any], header: int = 6) -> bytes:
    document = ezdxf.new()
    document.header["$INSUNITS"] = header
    for one in add:
        one(document.modelspace())
    return contents(document)
