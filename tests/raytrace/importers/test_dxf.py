"""DXF: a flat as architects draw it, and what the import makes of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import ezdxf
import numpy as np
import pytest

from raytrace.importers.dxf import read_dxf
from raytrace.importers.options import ImportOptions
from tests.raytrace.importers.drawings import (
    INCH,
    contents,
    ends,
    flat,
    imported,
    segment,
)


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
