"""DXF files of many writers: releases, line ends, curves, hatches, doors and wrong units."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest

from estimator.errors import FileFormatError
from raytrace.importers.convert import import_floorplan
from raytrace.importers.dxf import read_dxf
from raytrace.importers.options import ImportOptions
from tests.raytrace.importers.drawings import (
    INCH,
    box,
    contents,
    ends,
    flat,
    imported,
    segment,
)

VERSIONS = ["R12", "R2000", "R2004", "R2007", "R2010", "R2013", "R2018"]


def written(version: str, end: bytes, release: bytes | None = None) -> bytes:
    """A room as a writer of some release writes it, with binary data (a preview) in between."""
    document = ezdxf.new(version)
    document.header["$INSUNITS"] = 6
    space = document.modelspace()
    for (x0, y0), (x1, y1) in itertools.pairwise([*box(0, 0, 8, 5), (0, 0)]):
        space.add_line((x0, y0), (x1, y1), dxfattribs={"layer": "WALL"})
    text = contents(document)
    if version != "R12":
        preview = b"  0\nSECTION\n  2\nTHUMBNAILIMAGE\n 90\n        4\n310\n00FF10AB\n  0\nENDSEC\n  0\nEOF\n"
        text = text.replace(b"  0\nEOF\n", preview)
    if release is not None:
        text = text.replace(b"AC1009", release)
    return text.replace(b"\n", end)


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("version", VERSIONS)
def test_all_releases_and_line_ends(version: str, end: bytes) -> None:
    """AutoCAD writes carriage returns and binary tags; the same four walls come from every writer."""
    drawing = read_dxf(written(version, end), ImportOptions(unit="m" if version == "R12" else None))
    assert len(drawing.lines) == 4
    assert sum(line.length_m for line in drawing.lines) == pytest.approx(26.0)


@pytest.mark.parametrize("release", [b"AC1006", b"AC1004"])
def test_old_releases(release: bytes) -> None:
    """Drawings of the eighties (R10, R9) read as R12 does; their header has no unit, which the user gives."""
    assert len(read_dxf(written("R12", b"\r\n", release), ImportOptions(unit="m")).lines) == 4


def test_a_byte_order_mark_and_comments_may_come_first() -> None:
    """UTF-8 with a mark, and the comments (999) of some writers, are before the first section."""
    text = written("R2018", b"\r\n")
    assert len(read_dxf(b"\xef\xbb\xbf" + text, ImportOptions()).lines) == 4
    assert len(read_dxf(b"999\r\nmade by a program\r\n" + text, ImportOptions()).lines) == 4


def test_every_curve_is_a_wall() -> None:
    """Splines, ellipses, bulged polylines, multi-lines, solids: all give lines, none a traceback."""
    document = ezdxf.new()
    document.header["$INSUNITS"] = 6
    space, wall = document.modelspace(), {"layer": "WALL"}
    space.add_spline([(0, 0), (2, 1), (4, 0), (6, 1)], dxfattribs=wall)
    space.add_open_spline([(0, 0), (2, 1), (4, 0), (6, 1)], dxfattribs=wall)
    space.add_ellipse((10, 10), (4, 0), 0.5, dxfattribs=wall)
    space.add_lwpolyline([(0, 20, 0.5), (5, 20, 0)], format="xyb", dxfattribs=wall)
    space.add_polyline3d([(0, 30, 0), (5, 30, 2), (5, 35, 2)], dxfattribs=wall)
    space.add_polyline2d([(0, 40), (5, 40)], dxfattribs=wall)
    space.add_mline([(0, 50), (5, 50), (5, 55)], dxfattribs=wall)
    space.add_solid([(0, 60), (5, 60), (0, 61), (5, 61)], dxfattribs=wall)
    space.add_trace([(0, 70), (5, 70), (0, 71), (5, 71)], dxfattribs=wall)
    space.add_3dface([(0, 80, 0), (5, 80, 0), (5, 80, 3), (0, 80, 3)], dxfattribs=wall)
    space.add_arc((20, 20), 6, 0, 200, dxfattribs=wall)
    drawing = read_dxf(contents(document), ImportOptions())
    kept = {what.split()[0] for what in drawing.report.kept}
    assert kept == {
        "SPLINE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "MLINE", "SOLID", "TRACE", "3DFACE", "ARC"
    }  # fmt: skip
    assert not drawing.report.dropped
    assert all(np.isfinite([line.start_m, line.end_m]).all() for line in drawing.lines)


def test_hatches_are_walls_where_asked() -> None:
    """A filled wall gives its outline if the user says so, and is told of otherwise."""
    document = flat(1.0, 6)
    hatch = document.modelspace().add_hatch(dxfattribs={"layer": "A-WALL"})
    hatch.paths.add_polyline_path(box(2, 2, 3, 2.2), is_closed=True)
    plain = read_dxf(contents(document), ImportOptions())
    asked = read_dxf(contents(document), ImportOptions(hatches=True))
    assert len(asked.lines) == len(plain.lines) + 4
    assert any("HATCH" in what and "--hatches" in what for what in plain.report.dropped)


def doorway(layer: str, broken: bool) -> Any:
    """A room of 8 m x 5 m with a door of 90 cm in the west: leaf and swing on some layer."""
    document = ezdxf.new()
    document.header["$INSUNITS"] = 6
    space, wall = document.modelspace(), {"layer": "WALL"}
    west = [((0, 5), (0, 3)), ((0, 2.1), (0, 0))] if broken else [((0, 5), (0, 0))]
    for start, end in [((0, 0), (8, 0)), ((8, 0), (8, 5)), ((8, 5), (0, 5)), *west]:
        space.add_line(start, end, dxfattribs=wall)
    space.add_line((0, 2.1), (0.9, 2.1), dxfattribs={"layer": layer})
    space.add_arc((0, 2.1), 0.9, 0, 90, dxfattribs={"layer": layer})
    return document


@pytest.mark.parametrize("layer", ["WALL", "A-DOOR"])
@pytest.mark.parametrize("broken", [False, True])
def test_doors_are_openings(layer: str, broken: bool, tmp_path: Path) -> None:
    """Swing and leaf are no walls, whatever layer they are on; a wall drawn through the door is cut."""
    made = imported(doorway(layer, broken), tmp_path)
    assert segment(0.0, 3.0, 0.0, 5.0) in ends(made)
    assert segment(0.0, 0.0, 0.0, 2.1) in ends(made)
    assert len(made.plan.walls) == 5
    assert "1 swings of doors recognised" in made.drawing.report.notes


def many(unit: float, header: int, swing: bool = False) -> bytes:
    """Offices of 4 m along a passage, with jambs and ducts, drawn in some unit and marked as some other."""
    document = ezdxf.new()
    document.header["$INSUNITS"] = header
    space = document.modelspace()
    for row in range(7):
        x = 4.0 * row
        pieces = [*box(x, 0, x + 4, 5), (x, 0)]
        duct = [*box(x + 0.2, 4, x + 0.8, 4.6), (x + 0.2, 4)]
        for ring in (pieces, duct):
            for (x0, y0), (x1, y1) in itertools.pairwise(ring):
                space.add_line((x0 / unit, y0 / unit), (x1 / unit, y1 / unit), dxfattribs={"layer": "WALL"})
        if swing:
            space.add_arc((x / unit, 0), 0.9 / unit, 0, 90, dxfattribs={"layer": "DOORS"})
    return contents(document)


@pytest.mark.parametrize(("unit", "header"), [(0.01, 4), (1.0, 4), (0.001, 6), (INCH, 4)])
def test_a_wrong_unit_in_the_header_is_overruled_aloud(unit: float, header: int) -> None:
    """A plan that its header makes one of mice or giants is read by its walls and doors, with a warning."""
    drawing = read_dxf(many(unit, header, swing=True), ImportOptions())
    width = max(line.end_m[0] for line in drawing.lines)
    assert width == pytest.approx(28.0)
    assert len(drawing.report.warnings) == 1
    assert "--unit" in drawing.report.warnings[0]
    told = read_dxf(many(unit, header, swing=True), ImportOptions(unit="cm"))
    assert told.report.notes[0] == "unit cm, as told"


def test_a_missing_unit_is_read_off_the_walls_where_they_tell() -> None:
    """Fifty pieces and some doors tell centimetres from inches; what does not is refused with the spans."""
    drawing = read_dxf(many(0.01, 0, swing=True), ImportOptions())
    assert drawing.report.notes[0] == "unit cm, as the walls suggest"
    assert "the file states no unit" in drawing.report.warnings[0]
    with pytest.raises(FileFormatError, match=r"INSUNITS: expected a unit .*give one with --unit .*mm: "):
        read_dxf(contents(flat(1.0, 0)), ImportOptions())


def test_a_real_building_is_walked_in_its_rooms(tmp_path: Path) -> None:
    """Double walls, a shaft, a stair core, furniture, dimensions: the walk is in the rooms."""
    document = flat(1.0, 6)
    space, wall = document.modelspace(), {"layer": "A-WALL"}
    space.add_lwpolyline(box(1, 5, 2.5, 6.5), close=True, dxfattribs=wall)  # a shaft
    space.add_lwpolyline(box(9, 5, 11, 7.5), close=True, dxfattribs=wall)  # a core with a stair
    for step in range(8):
        space.add_line((9, 5.2 + 0.25 * step), (11, 5.2 + 0.25 * step), dxfattribs={"layer": "A-STAIRS"})
    chair = document.blocks.new("CHAIR")
    chair.add_lwpolyline(box(0, 0, 0.5, 0.5), close=True)
    space.add_blockref("CHAIR", (4, 2), dxfattribs={"layer": "A-FURN"})
    space.add_linear_dim((0, -1), (0, 0), (12, 0), dxfattribs={"layer": "A-DIMS"}).render()
    made = imported(document, tmp_path)
    track = made.plan.track()[:, :2]
    for low, high in (((1, 5), (2.5, 6.5)), ((9, 5), (11, 7.5))):
        assert not np.all((track > low) & (track < high), axis=1).any()
    assert track[:, 0].min() < 3
    assert track[:, 0].max() > 9
    assert np.all((track > 0.3) & (track < (11.7, 7.7)))


CASES = Path(__file__).parents[3].parent / "shared" / "cases" / "floorplans"


@pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not beside this checkout")
@pytest.mark.parametrize(
    ("case", "walls"), [("01/room-crlf", 4), ("02/room-lf", 4), ("03/spline", 17), ("05/door-gap", 9)]
)
def test_drawings_that_were_once_misread(case: str, walls: int) -> None:
    """Carriage returns, a spline and a door's gap: walls as drawn, a walk in the room, none in its shaft."""
    plan = import_floorplan(CASES / f"{case}.dxf").plan
    assert len(plan.walls) == walls
    track = plan.track()[:, :2]
    extent = np.ptp(np.vstack(plan.walls_m()), axis=0)
    assert np.all(np.ptp(track, axis=0) > 0.5 * extent)
