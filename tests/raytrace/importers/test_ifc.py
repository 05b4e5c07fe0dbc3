"""Building models (IFC): storeys, walls, doors, windows, materials, and files that are no such thing."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ifcopenshell", reason="IfcOpenShell has no wheel for this machine")

from estimator.errors import BackendError, FileFormatError
from raytrace.importers.convert import Imported, floorplan_of, import_floorplan
from raytrace.importers.drawing import Drawing
from raytrace.importers.ifc import drawing_of_model
from raytrace.importers.ifc_model import load_model, model_in
from raytrace.importers.inspection import inspect_drawing
from raytrace.importers.options import ImportOptions
from tests.raytrace.importers.models import House


def imported(house: House, **options: object) -> Imported:
    chosen = ImportOptions(**options)  # type: ignore[arg-type]
    drawing = drawing_of_model(model_in(house.bytes()), chosen)
    return Imported(floorplan_of(drawing, "house", chosen), drawing)


def lines(made: Imported) -> dict[frozenset[tuple[float, float]], tuple[str, float, float]]:
    return {
        frozenset((round(x, 3), round(y, 3)) for x, y in (wall.from_m, wall.to_m)): (
            wall.material,
            round(wall.thickness_m, 3),
            wall.height_m,
        )
        for wall in made.plan.walls
    }


PLAN = {
    frozenset([(0.1, 0.1), (1.0, 0.1)]): ("brick", 0.2, 3.0),
    frozenset([(1.0, 0.1), (2.5, 0.1)]): ("glass", 0.008, 2.2),
    frozenset([(2.5, 0.1), (7.9, 0.1)]): ("brick", 0.2, 3.0),
    frozenset([(7.9, 0.1), (7.9, 5.9)]): ("brick", 0.2, 3.0),
    frozenset([(0.1, 5.9), (7.9, 5.9)]): ("brick", 0.2, 3.0),
    frozenset([(0.1, 0.1), (0.1, 5.9)]): ("brick", 0.2, 3.0),
    frozenset([(4.05, 0.1), (4.05, 2.0)]): ("concrete", 0.1, 2.8),
    frozenset([(4.05, 2.9), (4.05, 5.9)]): ("concrete", 0.1, 2.8),
}


@pytest.mark.parametrize("version", ["IFC2X3", "IFC4", "IFC4X3"])
def test_a_house_is_its_plan(version: str) -> None:
    """Centre lines, a doorway, a pane in the middle of its wall; materials by the thickest layer's name."""
    house = House(version)
    house.rooms()
    made = imported(house)
    assert lines(made) == PLAN
    assert made.drawing.report.kept["IfcDoor as opening"] == 1
    assert made.plan.floor is None


def test_one_storey_of_several_is_taken() -> None:
    """Without --level the storeys are listed; a wall over two storeys is in both, as high as each."""
    house = House()
    house.rooms("Ground floor", 0.0, height_m=6.2)
    house.rooms("First floor", 3.2)
    house.begin("Attic", 6.4)
    with pytest.raises(
        FileFormatError, match=r"got 2 \(Ground floor, First floor\); choose one with --level"
    ):
        imported(house)
    with pytest.raises(FileFormatError, match="expected one of Ground floor, First floor, got 'Cellar'"):
        imported(house, level="Cellar")
    ground, first = (imported(house, level=name) for name in ("Ground floor", "First floor"))
    assert {wall.height_m for wall in ground.plan.walls if wall.material == "brick"} == {3.2}
    assert set(lines(first)) == set(PLAN)


def test_units_offsets_and_antennas() -> None:
    """Lengths are metres whatever the file's unit; far models come near; antennas become anchors."""
    house = House(length="METERS", offset_m=500_000.0)
    house.rooms()
    antenna = house.made("IfcCommunicationsAppliance", "pa west")
    house.place(antenna, 1.0, 2.0, 2.5)
    made = imported(house)
    assert [(a.name, a.position_m) for a in made.plan.anchors] == [("pa west", (1.0, 2.0, 2.5))]
    assert made.plan.georeference is not None
    assert made.plan.georeference.origin == (500_000.0, 500_000.0)
    assert set(lines(made)) == set(PLAN)


def test_slabs_furniture_and_what_the_user_says() -> None:
    """Slabs are floor and ceiling; furniture is left out, and reported; a pattern may name a class."""
    house = House()
    house.rooms()
    for name, at in (("floor", -0.2), ("roof", 3.0)):
        house.box("IfcSlab", name, (0, 0), (8, 6, 0.2), sill_m=at)
    house.box("IfcFurniture", "cupboard", (6, 3), (1, 0.5, 2))
    house.box("IfcColumn", "steel column", (2, 3), (0.3, 0.3, 3))
    made = imported(house, materials={"IfcColumn": "metal", "mauerwerk*": "wood"})
    plan = made.plan
    assert (plan.floor is not None, plan.ceiling is not None) == (True, True)
    assert made.drawing.report.dropped["IfcFurniture"] == 1
    assert {wall.material for wall in plan.walls} == {"wood", "glass", "concrete", "metal"}


def test_a_file_is_imported_and_inspected(tmp_path: Path) -> None:
    """From the file, in a process of its own: levels, layers, and the plan of the one that is chosen."""
    house = House()
    house.rooms("Ground floor", 0.0)
    house.rooms("First floor", 3.2)
    path = tmp_path / "house.ifc"
    path.write_bytes(house.bytes())
    facts, drawing = inspect_drawing(path)
    assert facts["levels"] == ["Ground floor", "First floor"]
    assert facts["layers"]["IfcWindow"]["taken_as"] == "glass"
    assert isinstance(drawing, Drawing)
    assert lines(import_floorplan(path, ImportOptions(level="First floor"))) == PLAN


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: b"%PDF-1.7", "expected an IFC file"),
        (lambda data: data.replace(b"IFC4", b"IFC7"), "expected an IFC file"),
        (lambda data: data.replace(b"IFCSHAPEREPRESENTATION(", b"IFCSHAPE("), "walls with a shape, got none"),
        (lambda data: data[: data.index(b"DATA;")], "expected walls with a shape, got none"),
        (lambda data: data.replace(b"(#", b"(#9"), "expected"),
    ],
)
def test_what_is_no_model_is_refused(damage: object, message: str) -> None:
    """Other files, other versions, nothing built, broken references: an error that says so."""
    house = House()
    house.rooms()
    with pytest.raises(FileFormatError, match=message):
        drawing_of_model(model_in(damage(house.bytes())), ImportOptions())  # type: ignore[operator]


def test_a_reader_that_dies_or_hangs_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """What brings the reader down, or keeps it too long, ends with a message, not with the program."""
    house = House()
    house.rooms()
    with pytest.raises(FileFormatError, match="made within 0.01 s, it takes longer"):
        load_model(house.bytes(), 0.01)
    monkeypatch.setattr("sys.executable", "/bin/false")
    with pytest.raises(FileFormatError, match="reading it ended with status 1"):
        load_model(house.bytes(), 60.0)


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message says what to install."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BackendError, match=r"pip install 'hapslam\[ifc\]'"):
        load_model(b"another file", 1.0)


def test_models_keep_their_precision() -> None:
    """What travels between the processes is what was read."""
    house = House()
    house.rooms()
    here, there = model_in(house.bytes()), load_model(house.bytes())
    assert [e.name for e in here.elements] == [e.name for e in there.elements]
    for one, other in zip(here.elements, there.elements, strict=True):
        assert np.array_equal(one.triangles, other.triangles)
        assert one.materials == other.materials
