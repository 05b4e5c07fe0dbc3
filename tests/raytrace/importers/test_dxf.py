"""DXF: a flat as architects draw it, and files that are no such thing."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest

from estimator.errors import FileFormatError, InputError
from raytrace.importers.convert import Imported, import_floorplan
from raytrace.importers.dxf import read_dxf
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


@pytest.mark.parametrize(("unit", "header"), [(INCH, 1), (0.001, 4), (1.0, 6), (0.3048, 2)])
def test_a_flat_comes_in_right(unit: float, header: int, tmp_path: Path) -> None:
    """Doors, blocks, double lines and inches: centre lines in metres, with their thickness and material."""
    made = imported(flat(unit, header), tmp_path)
    turn = math.radians(30)
    corner = 0.2 * (math.cos(turn) - math.sin(turn))
    other = 0.2 * (math.cos(turn) + math.sin(turn))
    column = [
        (3 - corner, 4 - other),
        (3 + other, 4 - corner),
        (3 + corner, 4 + other),
        (3 - other, 4 + corner),
    ]
    expected = {
        segment(0.15, 0.15, 11.85, 0.15),
        segment(11.85, 0.15, 11.85, 7.85),
        segment(0.15, 7.85, 11.85, 7.85),
        segment(0.15, 0.15, 0.15, 7.85),
        segment(7.05, 0.15, 7.05, 3.0),
        segment(7.05, 4.0, 7.05, 7.85),
        segment(4.0, 5.0, 5.0, 5.0),
        *(
            segment(*(round(value, 4) for value in (*a, *b)))
            for a, b in zip(column, column[1:] + column[:1], strict=True)
        ),
    }
    assert ends(made) == expected
    thickness = {
        "outer": {
            w.thickness_m for w in made.plan.walls if 7.05 not in w.from_m and 0.15 in (*w.from_m, *w.to_m)
        },
        "partition": {w.thickness_m for w in made.plan.walls if 7.05 in w.from_m},
    }
    assert thickness == {"outer": {0.3}, "partition": {0.1}}
    assert [w.material for w in made.plan.walls].count("glass") == 1


def test_the_report_tells_what_became_of_everything(tmp_path: Path) -> None:
    """Kept by layer, dropped with the reason, collapsed, and what was assumed or placed."""
    report = imported(flat(), tmp_path).drawing.report
    assert report.kept["LWPOLYLINE on layer A-WALL as concrete"] == 4
    assert report.kept["block unfolded"] == 2
    assert report.dropped["ARC on layer A-DOOR, ignored"] == 1
    assert report.dropped["TEXT on layer A-FURN, ignored"] == 1
    assert report.collapsed["pair of lines to one surface"] == 8
    assert report.collapsed["end of a wall, with its faces"] == 2
    assert report.notes[0] == "unit in, from the header"
    assert any("anchors" in note and "placed" in note for note in report.notes)


def test_layers_can_be_mapped(tmp_path: Path) -> None:
    """A pattern gives a layer its material or leaves it out, whatever its name says."""
    made = imported(flat(), tmp_path, materials={"a-wall": "brick", "*GLAZ": "ignore"})
    assert {wall.material for wall in made.plan.walls} == {"brick"}
    assert made.drawing.report.dropped["LINE on layer A-GLAZ, ignored"] == 1


def test_marked_anchors_and_track_are_taken(tmp_path: Path) -> None:
    """Points on a layer of anchors and a polyline on one of tracks are not placed anew."""
    document, scale = flat(), 1 / INCH
    document.modelspace().add_point((2 * scale, 2 * scale, 2.2 * scale), dxfattribs={"layer": "ANCHORS"})
    document.modelspace().add_lwpolyline(
        [(1 * scale, 1 * scale), (6 * scale, 1.5 * scale), (6 * scale, 7 * scale)],
        dxfattribs={"layer": "TRACK"},
    )
    made = imported(document, tmp_path)
    assert made.plan.anchors[0].position_m == pytest.approx((2.0, 2.0, 2.2))
    assert made.plan.agent.waypoints_m[0] == pytest.approx((1.0, 1.0))
    assert made.plan.agent.waypoints_m[-1] == pytest.approx((6.0, 7.0))
    assert len(made.plan.anchors) == 1


def test_binary_and_hidden_layers(tmp_path: Path) -> None:
    """The binary format reads alike; what is switched off or frozen is not there."""
    document = flat()
    document.layers.get("A-GLAZ").off()
    drawing = read_dxf(contents(document, binary=True), ImportOptions())
    assert drawing.report.dropped["LINE on hidden layer A-GLAZ"] == 1
    assert len(drawing.lines) == len(read_dxf(contents(document), ImportOptions()).lines) == 20


def test_curves_become_chords() -> None:
    """A round column of radius 0.5 m is a polygon whose sides stay within 2 cm of the circle."""
    document = ezdxf.new()
    document.header["$INSUNITS"] = 6
    document.modelspace().add_circle((4, 4), 0.5, dxfattribs={"layer": "COLUMN"})
    lines = read_dxf(contents(document), ImportOptions()).lines
    middles = [math.dist((4, 4), 0.5 * np.add(line.start_m, line.end_m)) for line in lines]
    assert 8 <= len(lines) <= 32
    assert 0.48 <= min(middles) <= max(middles) < 0.5


def test_far_drawings_are_moved_to_the_origin(tmp_path: Path) -> None:
    """Survey coordinates would cost the tracer its millimetres; the shift is reported."""
    document = flat(1.0, 6)
    for entity in document.modelspace():
        entity.translate(500_000.0, 4_000_000.0, 0.0)
    made = imported(document, tmp_path)
    assert segment(0.15, 0.15, 11.85, 0.15) in ends(made)
    assert "moved by (-500000, -4e+06) m to the origin" in made.drawing.report.notes


def test_references_to_other_files_are_not_followed(
    tmp_path: Path, opened_files: Callable[[], AbstractContextManager[list[str]]]
) -> None:
    """An external reference is reported; the only file that is opened is the one that was given."""
    other = flat(1.0, 6)
    other.saveas(tmp_path / "other.dxf")
    document = flat(1.0, 6)
    document.add_xref_def(str(tmp_path / "other.dxf"), "OTHER")
    document.modelspace().add_blockref("OTHER", (20, 0), dxfattribs={"layer": "A-WALL"})
    imported(document, tmp_path)  # what a first import loads is not of interest
    with opened_files() as opened:
        made = imported(document, tmp_path)
    assert set(opened) == {str(tmp_path / "flat.dxf")}
    assert made.drawing.report.dropped["INSERT of another file (OTHER), not followed"] == 1
    assert max(x for wall in made.plan.walls for x in (wall.from_m[0], wall.to_m[0])) < 12


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


def nested(depth: int) -> bytes:
    def change(document: Any) -> None:
        for level in range(depth):
            block = document.blocks.new(f"B{level}")
            for column in range(10):
                if level:
                    block.add_blockref(f"B{level - 1}", (column, 0))
                else:
                    block.add_line((0, 0), (1, 0))
        document.modelspace().add_blockref(f"B{depth - 1}", (0, 0), dxfattribs={"layer": "A-WALL"})

    return altered(change)


def circular(document: Any) -> None:
    for one, other in (("ONE", "TWO"), ("TWO", "ONE")):
        document.blocks.new(one).add_blockref(other, (0, 0))
    document.modelspace().add_blockref("ONE", (0, 0), dxfattribs={"layer": "A-WALL"})


def many_copies(document: Any) -> None:
    grid = {"column_count": 30_000, "row_count": 30_000, "column_spacing": 1, "row_spacing": 1}
    document.modelspace().add_blockref("COLUMN", (0, 0), dxfattribs={"layer": "A-WALL", **grid})


WALL = {"layer": "WALL"}
MALFORMED: dict[str, tuple[Callable[[], bytes], str]] = {
    "nothing": (lambda: b"", "got an empty file"),
    "blanks": (lambda: b" \n\n ", "got an empty file"),
    "prose": (lambda: b"This is a letter, not a drawing.\n" * 20, "starts with a SECTION"),
    "a picture": (lambda: b"\x89PNG\r\n\x1a\n" + bytes(200), "starts with a SECTION"),
    "a DWG": (lambda: b"AC1032" + bytes(500), "starts with a SECTION"),
    "XML": (lambda: b"<?xml version='1.0'?><scene/>", "starts with a SECTION"),
    "a stump": (lambda: contents(flat())[:300], "could not read it"),
    "half a file": (lambda: contents(flat())[: len(contents(flat())) // 2], "could not read it"),
    "half a binary": (lambda: contents(flat(), binary=True)[:5000], "could not read it"),
    "a group code in letters": (
        lambda: contents(flat()).replace(b"\n  8\n", b"\n eight\n", 3),
        "could not read it",
    ),
    "letters for a coordinate": (
        lambda: contents(flat(1.0, 6)).replace(b"\n 11\n7.0", b"\n 11\nseven", 1),
        "could not read it",
    ),
    "no unit": (lambda: contents(flat(1.0, 0)), "INSUNITS: expected a unit"),
    "light years": (lambda: contents(flat(1.0, 19)), "got unit 19"),
    "unknown layers": (
        lambda: only(lambda s: s.add_line((0, 0), (1, 1), dxfattribs={"layer": "QX"})),
        "layers that nothing fits: 'QX' (1)",
    ),
    "no entities": (lambda: only(), "expected walls"),
    "text alone": (lambda: only(lambda s: s.add_text("wall", dxfattribs=WALL)), "expected walls"),
    "points of no length": (
        lambda: only(lambda s: s.add_line((1, 1), (1, 1), dxfattribs=WALL)),
        "expected walls",
    ),
    "not a number": (
        lambda: only(lambda s: s.add_line((math.nan, 0), (1, 1), dxfattribs=WALL)),
        "expected finite coordinates",
    ),
    "infinite": (
        lambda: only(lambda s: s.add_line((0, 0), (1e300, 1), dxfattribs=WALL)),
        "expected finite coordinates",
    ),
    "blocks in each other": (lambda: altered(circular), "do not hold themselves"),
    "blocks to the power of six": (lambda: nested(6), "expected at most 20000 lines"),
    "copies": (lambda: altered(many_copies), "expected at most 200000 entities"),
    "a room for mice": (
        lambda: only(lambda s: s.add_lwpolyline(box(0, 0, 0.7, 0.7), close=True, dxfattribs=WALL)),
        "expected space to walk",
    ),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_files_are_told_in_one_line(name: str, tmp_path: Path) -> None:
    """Each says the file, what was expected and what came, as an error of the project's own."""
    make, message = MALFORMED[name]
    path = tmp_path / "bad.dxf"
    path.write_bytes(make())
    with pytest.raises(InputError) as caught:
        import_floorplan(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert message in text
    assert "expected" in text
    assert len(text) < 500


def test_a_missing_file_and_an_unknown_suffix(tmp_path: Path) -> None:
    """What is not there, and what no importer reads, is said so."""
    with pytest.raises(FileFormatError, match="could not read it: No such file"):
        import_floorplan(tmp_path / "none.dxf")
    with pytest.raises(FileFormatError, match="expected a name that ends in .dxf, .*got '.dwg'"):
        import_floorplan(tmp_path / "plan.dwg")


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
