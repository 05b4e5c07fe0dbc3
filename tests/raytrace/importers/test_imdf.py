"""Venues in IMDF: units, walkways, openings and levels, as folders and archives, and what is none."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from estimator.errors import InputError
from raytrace.importers.convert import import_floorplan
from raytrace.importers.inspection import inspect_drawing
from raytrace.importers.options import ImportOptions

EAST_DEG, NORTH_DEG = 1.3419e-5, 8.9925e-6  # a metre at 48 degrees north


def feature(kind: str, identity: str, points: list[tuple[float, float]], **properties: Any) -> dict[str, Any]:
    places = [[2.0 + x * EAST_DEG, 48.0 + y * NORTH_DEG] for x, y in points]
    geometry = (
        {"type": "LineString", "coordinates": places}
        if kind == "opening"
        else {"type": "Polygon", "coordinates": [[*places, places[0]]]}
    )
    told = {"type": "Feature", "id": identity, "feature_type": kind}
    return {**told, "properties": properties, "geometry": geometry}


def box(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float]]:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def venue() -> dict[str, list[dict[str, Any]]]:
    """Two shops of 8 m x 6 m on a hall of two walkways, and another level above."""
    ground = {"level_id": "L0"}
    return {
        "level": [
            feature("level", "L0", box(0, 0, 16, 10), ordinal=0, name={"en": "Ground"}),
            feature("level", "L1", box(0, 0, 16, 10), ordinal=1, name={"en": "First"}),
        ],
        "unit": [
            feature("unit", "a", box(0, 4, 8, 10), category="room", name={"en": "Doors & Co"}, **ground),
            feature("unit", "b", box(8, 4, 16, 10), category="room", **ground),
            feature("unit", "c", box(0, 0, 8, 4), category="walkway", **ground),
            feature("unit", "d", box(8, 0, 16, 4), category="walkway", **ground),
            feature("unit", "e", box(0, 0, 16, 10), category="room", level_id="L1"),
        ],
        "opening": [feature("opening", "o", [(3, 4), (4.5, 4)], category="pedestrian", **ground)],
        "footprint": [feature("footprint", "f", box(-1, -1, 17, 11), category="ground")],
    }


def files(parts: dict[str, list[dict[str, Any]]]) -> dict[str, str]:
    return {
        f"{kind}.geojson": json.dumps({"type": "FeatureCollection", "name": kind, "features": features})
        for kind, features in parts.items()
    }


def packed(contents: dict[str, str], folder: str = "venue/") -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in contents.items():
            archive.writestr(folder + name, text)
    return stream.getvalue()


@pytest.mark.parametrize("as_archive", [False, True])
def test_a_venue_is_one_of_its_levels(as_archive: bool, tmp_path: Path) -> None:
    """Shops and the hall's outline are walls, none stands between walkways, and the opening is open."""
    path = tmp_path / ("venue.zip" if as_archive else "venue")
    if as_archive:
        path.write_bytes(packed(files(venue())))
    else:
        path.mkdir()
        for name, text in files(venue()).items():
            (path / name).write_text(text)
    assert inspect_drawing(path)[0]["levels"] == ["0", "1"]
    with pytest.raises(InputError, match=r"expected one level, got 2 \(0, 1\)"):
        import_floorplan(path)
    plan = import_floorplan(path, ImportOptions(level="0")).plan
    origin = 8.0, 5.0  # what the map was flattened about
    walls = {
        frozenset((round(x + origin[0], 1) + 0.0, round(y + origin[1], 1) + 0.0) for x, y in ends)
        for ends in ((wall.from_m, wall.to_m) for wall in plan.walls)
    }
    assert frozenset([(8.0, 4.0), (8.0, 10.0)]) in walls  # between the shops
    assert frozenset([(0.0, 4.0), (3.0, 4.0)]) in walls  # beside the opening
    assert frozenset([(0.0, 0.0), (16.0, 0.0)]) in walls  # the walkways are one
    assert not any(wall == frozenset([(8.0, 0.0), (8.0, 4.0)]) for wall in walls)
    assert plan.georeference is not None
    assert plan.georeference.crs == "EPSG:4326"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK\x03\x04 and no more", "expected an archive"),
        (packed({}), "with unit.geojson, got no file of one"),
        (packed(files({"level": venue()["level"]})), "with unit.geojson, got level"),
        (packed({"unit.geojson": "{"}), "unit.geojson: expected JSON"),
        (packed({"unit.geojson": " " * (65 * 2**20)}), "expected at most 64 MiB, got 65 MiB"),
        (
            packed(
                files({"unit": [{**venue()["unit"][2], "geometry": {"type": "Polygon", "coordinates": 1}}]})
            ),
            "expected polygons",
        ),
    ],
)
def test_what_is_no_venue_is_refused(data: bytes, message: str, tmp_path: Path) -> None:
    """Broken archives, other files, archives that unpack to more than a plan: errors that say so."""
    path = tmp_path / "venue.zip"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        import_floorplan(path, ImportOptions(level="0"))
