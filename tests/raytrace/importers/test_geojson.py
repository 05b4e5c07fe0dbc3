"""GeoJSON: rooms in metres and in degrees, and files that are no such thing."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from estimator.errors import FileFormatError, InputError
from raytrace.importers.conventions import levels_of, meaning
from raytrace.importers.convert import Imported, import_floorplan
from raytrace.importers.options import ImportOptions

ROOM = [[0.0, 0.0], [9.0, 0.0], [9.0, 6.0], [0.0, 6.0], [0.0, 0.0]]


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }


def collection(*features: Any) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(features)}


def imported(root: Any, folder: Path, **options: Any) -> Imported:
    path = folder / "plan.geojson"
    path.write_text(root if isinstance(root, str) else json.dumps(root))
    return import_floorplan(path, ImportOptions(**options))


def test_features_become_walls_anchors_and_track(tmp_path: Path) -> None:
    """Material, height and thickness of the properties; roles of points and lines; the rest dropped."""
    made = imported(
        collection(
            feature("Polygon", [ROOM], material="brick", height_m=2.7, thickness_m=0.24),
            feature("LineString", [[4.0, 0.0], [4.0, 3.0]], **{"class": "glass wall", "thickness": 0.02}),
            feature("Point", [7.0, 5.0, 2.4], role="anchor", name="north"),
            feature("LineString", [[1.0, 1.0], [2.0, 5.0], [8.0, 4.0]], role="track"),
            feature("Point", [3.0, 3.0], name="plant"),
            feature("LineString", [[1.0, 1.0], [2.0, 2.0]], role="ignore"),
            {"type": "Feature", "properties": None, "geometry": None},
        ),
        tmp_path,
    )
    plan = made.plan
    assert sorted((wall.material, wall.height_m, wall.thickness_m) for wall in plan.walls) == [
        *[("brick", 2.7, 0.24)] * 4,
        ("glass", 3.0, 0.02),
    ]
    assert [(anchor.name, anchor.position_m) for anchor in plan.anchors] == [("north", (7.0, 5.0, 2.4))]
    assert plan.agent.waypoints_m == ((1.0, 1.0), (2.0, 5.0), (8.0, 4.0))
    assert made.drawing.report.dropped == {"Point as wall": 1, "LineString as ignore": 1}


def test_degrees_become_metres(tmp_path: Path) -> None:
    """A room of a thousandth of a degree at 60 N has the sides that WGS 84 gives it, to a centimetre."""
    lon, lat, d = 24.9, 60.0, 1e-3
    ring = [[lon, lat], [lon + d, lat], [lon + d, lat + d], [lon, lat + d], [lon, lat]]
    made = imported(feature("Polygon", [ring]), tmp_path)
    sides = sorted(math.dist(wall.from_m, wall.to_m) for wall in made.plan.walls)
    # Published lengths of a degree at latitude 60: 55 800 m of longitude, 111 412 m of latitude.
    assert sides == pytest.approx([55.80, 55.80, 111.41, 111.41], abs=0.01)


def test_a_unit_overrules_degrees(tmp_path: Path) -> None:
    """What could be degrees is feet if that is told."""
    ring = [[0.0, 0.0], [0.03, 0.0], [0.03, 0.02], [0.0, 0.02], [0.0, 0.0]]
    made = imported(feature("Polygon", [ring]), tmp_path, unit="km")
    assert max(wall.to_m[0] for wall in made.plan.walls) == pytest.approx(30.0)


def test_thick_outlines_collapse(tmp_path: Path) -> None:
    """A room drawn as a polygon with a hole, 0.3 m apart, has walls of 0.3 m along the middle."""
    hole = [[0.3, 0.3], [8.7, 0.3], [8.7, 5.7], [0.3, 5.7], [0.3, 0.3]]
    made = imported(collection(feature("Polygon", [ROOM, hole], material="concrete")), tmp_path)
    assert {wall.thickness_m for wall in made.plan.walls} == {0.3}
    assert {wall.from_m for wall in made.plan.walls} | {wall.to_m for wall in made.plan.walls} == {
        (0.15, 0.15),
        (8.85, 0.15),
        (8.85, 5.85),
        (0.15, 5.85),
    }


def test_shared_borders_of_rooms_are_one_wall(tmp_path: Path) -> None:
    """Two rooms that share a border have seven walls, not eight, and the shared one is counted."""
    one = [[0, 0], [5, 0], [5, 4], [0, 4], [0, 0]]
    two = [[5, 0], [9, 0], [9, 5], [5, 5], [5, 0]]
    geometry = {
        "type": "GeometryCollection",
        "geometries": [{"type": "MultiPolygon", "coordinates": [[one], [two]]}],
    }
    made = imported(geometry, tmp_path)
    assert len(made.plan.walls) == 6
    assert made.drawing.report.collapsed["line continued or drawn twice"] == 2


BAD_PROPERTY = [[0.0, 0.0], [9.0, 0.0]]
MALFORMED: dict[str, tuple[Any, str]] = {
    "nothing": ("", "got an empty file"),
    "prose": ("walls: many", "expected JSON"),
    "a stump": (json.dumps(feature("Polygon", [ROOM]))[:60], "expected JSON"),
    "NaN": ('{"type": "Point", "coordinates": [NaN, 0]}', "expected finite numbers, got NaN"),
    "a list": ("[]", "expected a GeoJSON object, got list"),
    "a number": ("7", "expected a GeoJSON object, got int"),
    "no type": ({}, "type: expected FeatureCollection"),
    "TopoJSON": ({"type": "Topology", "arcs": []}, "got 'Topology'"),
    "features missing": ({"type": "FeatureCollection"}, "features: expected a list, got NoneType"),
    "no features": (collection(), "expected at least one geometry"),
    "a feature that is none": (collection(5), "features[0]: expected an object of type 'Feature'"),
    "properties in a list": (
        collection({"type": "Feature", "properties": [], "geometry": None}),
        "features[0].properties: expected an object",
    ),
    "a curve": (
        collection(feature("CircularString", [])),
        "features[0].geometry: expected a GeoJSON geometry",
    ),
    "a geometry of text": (
        collection({"type": "Feature", "properties": {}, "geometry": "POINT (1 2)"}),
        "features[0].geometry: expected a GeoJSON geometry",
    ),
    "words for numbers": (collection(feature("LineString", [["a", "b"], [1, 2]])), "expected coordinates"),
    "a line of one point": (collection(feature("LineString", [[1, 2]])), "expected coordinates"),
    "ragged coordinates": (collection(feature("LineString", [[1, 2], [3]])), "features[0].geometry"),
    "coordinates missing": (
        collection({"type": "Feature", "properties": {}, "geometry": {"type": "Point"}}),
        "features[0].geometry: expected coordinates",
    ),
    "an infinite number": ('{"type": "LineString", "coordinates": [[0, 0], [1e999, 0]]}', "expected finite"),
    "a billion metres": (collection(feature("LineString", [[0, 0], [1e9, 0]])), "below 1e+08 m"),
    "an unknown material": (
        collection(feature("LineString", BAD_PROPERTY, material="unobtainium")),
        "material",
    ),
    "a material of numbers": (collection(feature("LineString", BAD_PROPERTY, material=3)), "expected a name"),
    "a negative height": (
        collection(feature("LineString", BAD_PROPERTY, height_m=-3)),
        "height_m: expected metres",
    ),
    "a thickness in words": (collection(feature("LineString", BAD_PROPERTY, thickness="thin")), "thickness"),
    "an unknown role": (
        collection(feature("LineString", BAD_PROPERTY, role="hero")),
        "role: expected one of wall",
    ),
    "points alone": (collection(feature("Point", [1, 2])), "expected lines or polygons that are walls"),
    "nested without end": ('{"type": "GeometryCollection", "geometries": [' * 100_000, "expected JSON"),
    "Latin-1": ('{"type": "Tür"}'.encode("latin-1"), "expected UTF-8"),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_files_are_told_in_one_line(name: str, tmp_path: Path) -> None:
    """Each says the file, the field, what was expected and what came, as an error of the project's own."""
    content, message = MALFORMED[name]
    path = tmp_path / "bad.geojson"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(InputError) as caught:
        import_floorplan(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert message in text
    assert "expected" in text
    assert len(text) < 600


CASES = Path(__file__).parents[3].parent / "shared" / "cases" / "floorplans"
shared = pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not beside this checkout")


@shared
def test_levels_are_not_merged() -> None:
    """Three storeys in one file: none is taken unasked, each is what it is, a fourth is refused."""
    path = CASES / "15" / "levels.geojson"
    with pytest.raises(FileFormatError, match=r"got 3 \(0, 1, 2\); choose one with --level"):
        import_floorplan(path)
    for level, width in (("0", 14.9), ("1", 9.7), ("2", 6.7)):
        made = import_floorplan(path, ImportOptions(level=level))
        assert len(made.plan.walls) == 4
        x = [end[0] for wall in made.plan.walls for end in (wall.from_m, wall.to_m)]
        assert max(x) - min(x) == pytest.approx(width, abs=0.1)
        assert made.drawing.report.dropped["feature on another level"] == 2
    with pytest.raises(FileFormatError, match="level: expected one of 0, 1, 2, got '7'"):
        import_floorplan(path, ImportOptions(level="7"))


@shared
def test_doors_and_icons_are_no_concrete() -> None:
    """GDAL's "Layer", OpenStreetMap's indoor=door, an icon: doors open, icons go, patterns count."""
    path = CASES / "17" / "poi.geojson"
    made = import_floorplan(path)
    report = made.drawing.report
    assert report.kept == {
        "Polygon as concrete ('WALL')": 1,
        "LineString as opening ('DOORS')": 1,
        "LineString as opening (indoor=door)": 1,
    }
    assert report.dropped == {"Polygon as ignore ('wheelchair')": 1}
    assert sum(wall.name.startswith("features[0]") for wall in made.plan.walls) == 5  # cut by one door
    ignored = import_floorplan(path, ImportOptions(materials={"DOORS": "ignore"}))
    assert len(ignored.plan.walls) == 4
    assert ignored.drawing.report.dropped["LineString as ignore"] == 1


@pytest.mark.parametrize(
    ("stated", "metres"),
    [("3", 3.0), ("2.70", 2.7), ("2,7 m", 2.7), (" 3.5m ", 3.5), ("270 cm", 2.7), ("10 ft", 3.048), (4, 4.0)],
)
def test_numbers_may_be_texts(stated: Any, metres: float, tmp_path: Path) -> None:
    """OpenStreetMap states heights as texts, with or without a unit, and GDAL names keys as it likes."""
    made = imported(collection(feature("Polygon", [ROOM], Height=stated)), tmp_path)
    assert [wall.height_m for wall in made.plan.walls] == [pytest.approx(metres)] * 4


@pytest.mark.parametrize(
    ("properties", "role"),
    [
        ({"highway": "footway"}, "ignore"),
        ({"amenity": "toilets"}, "ignore"),
        ({"indoor": "area"}, "ignore"),
        ({"indoor": "corridor"}, "ignore"),
        ({"feature_type": "level"}, "ignore"),
        ({"feature_type": "amenity", "category": "elevator"}, "ignore"),
        ({"LAYER": "ROADS"}, "ignore"),
        ({"Layer": "A-FURN"}, "ignore"),
        ({"door": "yes"}, "opening"),
        ({"entrance": "main"}, "opening"),
        ({"feature_type": "opening", "category": "pedestrian"}, "opening"),
        ({"building": "yes"}, "wall"),
        ({"barrier": "wall"}, "wall"),
        ({"indoor": "room", "room": "stairs"}, "wall"),
        ({"feature_type": "unit", "category": "walkway"}, "wall"),
        ({"Class": "glazing"}, "wall"),
        ({"anything": 7}, "wall"),
    ],
)
def test_conventions_of_others(properties: dict[str, Any], role: str) -> None:
    """What OpenStreetMap, IMDF and GDAL say of a feature decides what it is, not its having an outline."""
    assert meaning("f", properties, "Polygon", ImportOptions()).role == role


@pytest.mark.parametrize(
    ("properties", "levels"),
    [
        ({"level": "0;1"}, {"0", "1"}),
        ({"level": "-1-1"}, {"-1", "0", "1"}),
        ({"Level": 2.0}, {"2"}),
        ({"level": "0.5"}, {"0.5"}),
        ({"storey": "EG"}, {"EG"}),
        ({"level_id": "abc"}, {"3"}),
        ({}, set()),
    ],
)
def test_levels_are_read(properties: dict[str, Any], levels: set[str]) -> None:
    """Lists, ranges, numbers and references to features of IMDF that are levels themselves."""
    assert levels_of("f", properties, {"abc": {"ordinal": 3}}) == levels


def test_an_unlevelled_feature_is_on_every_level(tmp_path: Path) -> None:
    """An outline without a level stays when a level is chosen."""
    inner = [[[1, 1], [4, 1], [4, 4], [1, 4], [1, 1]]]
    data = collection(
        feature("Polygon", [ROOM]), feature("Polygon", inner, level=1), feature("Polygon", inner, level=2)
    )
    assert len(imported(data, tmp_path, level="1").plan.walls) == 8


def test_a_door_that_is_a_point_opens_its_wall(tmp_path: Path) -> None:
    """A node with door=yes on a wall makes a gap of 90 cm around it."""
    made = imported(
        collection(feature("Polygon", [ROOM]), feature("Point", [4.0, 0.0], door="yes")), tmp_path
    )
    south = [wall for wall in made.plan.walls if wall.from_m[1] == wall.to_m[1] == 0.0]
    assert sorted(x for wall in south for x, _ in (wall.from_m, wall.to_m)) == [0.0, 3.55, 4.45, 9.0]


def test_degrees_are_kept_as_georeference(tmp_path: Path) -> None:
    """The plan says which longitude and latitude its origin is."""
    room = [[2.0, 48.0], [2.0002, 48.0], [2.0002, 48.0001], [2.0, 48.0001], [2.0, 48.0]]
    made = imported(collection(feature("Polygon", [room])), tmp_path)
    assert made.plan.georeference is not None
    assert made.plan.georeference.crs == "EPSG:4326"
    assert made.plan.georeference.origin == pytest.approx((2.0001, 48.00005))


def test_walkable_space_is_taken_as_drawn(tmp_path: Path) -> None:
    """Where the file says where one walks, the agent does not leave it."""
    drawn = [[1, 1], [4, 1], [4, 4], [1, 4], [1, 1]]
    made = imported(
        collection(feature("Polygon", [ROOM]), feature("Polygon", [drawn], role="walkable")), tmp_path
    )
    track = made.plan.track()[:, :2]
    assert track.min() >= 1.0
    assert track.max() <= 4.0
