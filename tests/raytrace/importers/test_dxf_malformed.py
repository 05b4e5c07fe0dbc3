"""DXF files that are broken, hostile or missing: each is told in one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from estimator.errors import FileFormatError, InputError
from raytrace.importers.convert import import_floorplan
from tests.raytrace.importers.drawings import (
    altered,
    box,
    contents,
    flat,
    only,
)


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
