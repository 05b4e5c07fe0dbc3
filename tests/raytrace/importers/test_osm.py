"""OpenStreetMap's XML: rooms, doors and levels as tagged, and files that are no such thing."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.errors import InputError
from raytrace.importers.convert import import_floorplan
from raytrace.importers.inspection import inspect_drawing
from raytrace.importers.options import ImportOptions

NODES = [(2.0, 48.0), (2.0002, 48.0), (2.0002, 48.0001), (2.0, 48.0001), (2.0001, 48.0), (2.0003, 48.00005)]

DOOR = '<tag k="door" v="yes"/>'


def text(*ways: str) -> str:
    nodes = "".join(
        f'<node id="{number}" lon="{x}" lat="{y}">{DOOR if number == 4 else ""}</node>'
        for number, (x, y) in enumerate(NODES)
    )
    return f'<?xml version="1.0"?><osm version="0.6">{nodes}{"".join(ways)}<relation id="9"/></osm>'


def way(number: int, nodes: list[int], **tags: str) -> str:
    refs = "".join(f'<nd ref="{node}"/>' for node in nodes)
    said = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
    return f'<way id="{number}">{refs}{said}</way>'


ROOM = [0, 4, 1, 2, 3, 0]


def test_rooms_doors_and_levels(tmp_path: Path) -> None:
    """A room is its outline, cut by the door on it; a path is no wall; a level has to be chosen."""
    path = tmp_path / "mall.osm"
    path.write_text(
        text(
            way(1, ROOM, indoor="room", level="0", height="3.5 m"),
            way(2, ROOM, indoor="room", level="1"),
            way(3, [4, 5], highway="footway"),
        )
    )
    with pytest.raises(InputError, match="choose one with --level"):
        import_floorplan(path)
    made = import_floorplan(path, ImportOptions(level="0"))
    assert len(made.plan.walls) == 5
    assert {wall.height_m for wall in made.plan.walls} == {3.5}
    dropped = made.drawing.report.dropped
    assert dropped["LineString as ignore (highway=footway)"] == 1
    assert inspect_drawing(path)[0]["levels"] == ["0", "1"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("<scene/>", "expected an <osm>, got <scene>"),
        ("<osm", "expected XML, could not read it"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><osm>&a;</osm>', "without document type"),
        (text(way(1, [0, 77], indoor="wall")), "node '77' is not"),
        ('<osm><node id="1" lon="east" lat="0"/></osm>', "expected lon and lat in degrees"),
        (text(way(1, [4, 5], highway="footway")), "walls, got none"),
    ],
)
def test_malformed_files_are_told_in_one_line(data: str, message: str, tmp_path: Path) -> None:
    """Each names the file, what was expected and what came."""
    path = tmp_path / "bad.osm"
    path.write_text(data)
    with pytest.raises(InputError) as caught:
        import_floorplan(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
