"""GeoJSON: lines and outlines as walls, points as anchors, doors as openings, one level of several.

What a feature is follows from its properties (:mod:`raytrace.importers.conventions`).
Coordinates are degrees (RFC 7946) if they can be: a building spans less than a tenth of a
degree, and no room is smaller than a tenth of a metre. Features of JSON-FG have their
``place`` in metres.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import shapely
from shapely.geometry import shape

from estimator.errors import FileFormatError
from raytrace.importers.conventions import levels_of, lowered, meaning, metres_of
from raytrace.importers.drawing import Drawing, Line, Opening, require_finite, require_size
from raytrace.importers.openings import cut_openings
from raytrace.importers.options import UNITS_M, ImportOptions

__all__ = ["Feature", "drawing_of", "features_in", "levels_in", "read_geojson"]

Feature = tuple[str, Mapping[str, Any], Any]

_GEOMETRIES = frozenset(
    ["Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection"]
)
_WIDEST_DEG = 0.1
# Semi-axes of WGS 84, metres.
_MAJOR_M, _MINOR_M = 6_378_137.0, 6_356_752.314_245


def read_geojson(data: bytes, options: ImportOptions) -> Drawing:
    """Read a GeoJSON feature collection, feature or geometry.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    options : ImportOptions
        How to read it; ``material`` defaults to concrete here, where outlines often have none.

    Raises
    ------
    FileFormatError
        If it is no GeoJSON, a feature is malformed, or there is no wall.
    """
    return drawing_of(features_in(data), options)


def drawing_of(features: list[Feature], options: ImportOptions) -> Drawing:
    """A drawing of features, whatever file they were in: place, properties and GeoJSON geometry of each.

    Raises
    ------
    FileFormatError
        If a feature is malformed, there are several levels and none was chosen, or there is no wall.
    """
    drawing = Drawing()
    chosen = _on_level(features, options.level, drawing)
    parts = [
        (where, properties, part)
        for where, properties, geometry in chosen
        for part in _parts(_geometry(where, geometry))
    ]
    if not parts:
        raise FileFormatError("features: expected at least one geometry, got none")
    project = _projection(parts, options, drawing)
    for where, properties, part in parts:
        _take(where, properties, part, project, options, drawing)
    if not drawing.lines:
        raise FileFormatError("features: expected lines or polygons that are walls, got none")
    drawing.lines = cut_openings(drawing.lines, drawing.openings, options.thickest_m, drawing.report)
    return drawing


def features_in(data: bytes) -> list[Feature]:
    """Features of a GeoJSON file; raises FileFormatError if it is none."""
    return list(_features(_parse(require_size(data))))


def levels_in(features: list[Feature]) -> list[str]:
    """Levels that features state, in order."""
    return sorted({one for some in _stated_levels(features) for one in some}, key=_by_number)


def _stated_levels(features: list[Feature]) -> list[frozenset[str]]:
    """Levels of every feature; those that are levels themselves (IMDF) give the others their ordinals."""
    names = {
        str(properties.get("id") or properties.get("level_id") or ""): properties
        for _, properties, _ in features
        if lowered(properties).get("feature_type") == "level"
    }
    return [levels_of(where, properties, names) for where, properties, _ in features]


def _on_level(features: list[Feature], level: str | None, drawing: Drawing) -> list[Feature]:
    """Features of one level, and those that state none, which are on all."""
    stated = _stated_levels(features)
    there = sorted({one for some in stated for one in some}, key=_by_number)
    if level is None and len(there) > 1:
        raise FileFormatError(
            f"levels: expected one level, got {len(there)} ({', '.join(there[:12])}"
            f"{', ...' if len(there) > 12 else ''}); choose one with --level"
        )
    if level is not None and level not in there:
        raise FileFormatError(
            f"level: expected one of {', '.join(there) or 'none that the file states'}, got {level!r}"
        )
    if there:
        drawing.report.notes.append(f"level {level or there[0]} of {', '.join(there)}")
    others = sum(bool(some) and level is not None and level not in some for some in stated)
    if others:
        drawing.report.dropped["feature on another level"] += others
    return [
        feature
        for feature, some in zip(features, stated, strict=True)
        if not some or level is None or level in some
    ]


def _by_number(level: str) -> tuple[float, str]:
    try:
        return float(level), level
    except ValueError:
        return math.inf, level


def _parse(data: bytes) -> Any:
    def refuse(name: str) -> float:
        raise FileFormatError(f"expected finite numbers, got {name}")

    try:
        return json.loads(data.decode("utf-8-sig"), parse_constant=refuse)
    except FileFormatError:
        raise
    except UnicodeDecodeError as error:
        raise FileFormatError(f"expected UTF-8, got byte {data[error.start]:#x}") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"expected JSON, could not read it: {error}") from error


def _features(root: Any) -> Iterator[Feature]:
    """Where, properties and geometry of every feature."""
    if not isinstance(root, dict):
        raise FileFormatError(f"expected a GeoJSON object, got {type(root).__name__}")
    kind = root.get("type")
    if kind == "FeatureCollection":
        listed = root.get("features")
        if not isinstance(listed, list):
            raise FileFormatError(f"features: expected a list, got {type(listed).__name__}")
        entries = [(f"features[{index}]", feature) for index, feature in enumerate(listed)]
    elif kind == "Feature":
        entries = [("feature", root)]
    elif kind in _GEOMETRIES:
        entries = [("geometry", {"type": "Feature", "properties": {}, "geometry": root})]
    else:
        raise FileFormatError(f"type: expected FeatureCollection, Feature or a geometry, got {kind!r}")
    for where, feature in entries:
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise FileFormatError(f"{where}: expected an object of type 'Feature', got {str(feature)[:60]}")
        properties = feature.get("properties")
        if not isinstance(properties, dict | None):
            raise FileFormatError(f"{where}.properties: expected an object, got {str(properties)[:60]}")
        said = {key: feature[key] for key in ("id", "feature_type", "featureType") if key in feature}
        place = feature.get("place") or feature.get("geometry")  # JSON-FG has metres in its place
        if place is not None:  # null is allowed: a feature without a place
            yield where, {**said, **(properties or {})}, place


def _geometry(where: str, geometry: Any) -> shapely.Geometry:
    if not isinstance(geometry, dict) or geometry.get("type") not in _GEOMETRIES:
        raise FileFormatError(f"{where}.geometry: expected a GeoJSON geometry, got {str(geometry)[:60]}")
    try:
        made = shape(geometry)
        coordinates = shapely.get_coordinates(made, include_z=False)
    except Exception as error:  # shapely raises errors of many kinds on wrong coordinates
        text = f"{type(error).__name__}: {error}"[:100]
        raise FileFormatError(
            f"{where}.geometry: expected coordinates of a {geometry['type']}: {text}"
        ) from error
    if made.is_empty or not np.isfinite(coordinates).all():
        raise FileFormatError(f"{where}.geometry: expected finite coordinates, got {str(geometry)[:60]}")
    return made


def _parts(geometry: shapely.Geometry) -> Iterator[shapely.Geometry]:
    """Points, lines and polygons of a geometry."""
    parts = getattr(geometry, "geoms", None)
    if parts is None:
        yield geometry
    else:
        for part in parts:
            yield from _parts(part)


class _Projection:
    """Coordinates to metres: times a unit, or from degrees to the plane that touches the middle."""

    def __init__(self, scale: tuple[float, float], origin: tuple[float, float]) -> None:
        self.scale, self.origin = np.array(scale), np.array(origin)

    def __call__(self, geometry: shapely.Geometry) -> list[tuple[float, float]]:
        points = (shapely.get_coordinates(geometry) - self.origin) * self.scale
        return [(float(x), float(y)) for x, y in points]


def _projection(
    features: list[tuple[str, Mapping[str, Any], shapely.Geometry]], options: ImportOptions, drawing: Drawing
) -> _Projection:
    points = np.concatenate([shapely.get_coordinates(part) for _, _, part in features])
    low, high = points.min(axis=0), points.max(axis=0)
    degrees = bool(np.all(high - low < _WIDEST_DEG) and np.all(np.abs(points) <= (180.0, 90.0)))
    if options.unit is not None or not degrees:
        unit = options.unit or "m"
        drawing.report.notes.append(
            f"unit {unit}, {'as told' if options.unit else 'coordinates are no degrees'}"
        )
        return _Projection((UNITS_M[unit],) * 2, (0.0, 0.0))
    longitude, latitude = 0.5 * (low + high)
    sine, cosine = math.sin(math.radians(latitude)), math.cos(math.radians(latitude))
    flat = 1.0 - (_MINOR_M / _MAJOR_M) ** 2
    bend = 1.0 - flat * sine**2
    east = math.radians(1.0) * _MAJOR_M * cosine / math.sqrt(bend)
    north = math.radians(1.0) * _MAJOR_M * (1.0 - flat) / bend**1.5
    drawing.report.notes.append(f"degrees, flattened about {latitude:.6f} N, {longitude:.6f} E")
    drawing.georeference = ("EPSG:4326", (float(longitude), float(latitude)))
    return _Projection((east, north), (float(longitude), float(latitude)))


def _take(
    where: str,
    properties: Mapping[str, Any],
    part: shapely.Geometry,
    project: _Projection,
    options: ImportOptions,
    drawing: Drawing,
) -> None:
    kind = part.geom_type
    taken = meaning(where, properties, kind, options)
    if taken.role == "anchor" and kind == "Point":
        _take_anchor(where, properties, part, project, drawing)
        return
    because = f" ({taken.label})" if taken.label and kind != "Point" else ""
    told = f"{kind} as {taken.role}{because}"
    if taken.role == "track" and kind == "LineString":
        drawing.track_m = project(part)
    elif taken.role == "walkable" and kind == "Polygon":
        drawing.space_m.append(project(part.exterior))
    elif taken.role == "opening" and kind in ("Point", "LineString"):
        points = project(part)
        drawing.openings.append(Opening(points[0], points[-1]))
    elif taken.role == "wall" and kind != "Point":
        told = f"{kind} as {taken.material}{because}"
        height = metres_of(where, properties, "height", options.height_m)
        thickness = metres_of(where, properties, "thickness", options.thickness_m)
        rings = [part] if kind in ("LineString", "LinearRing") else [part.exterior, *part.interiors]
        for ring in rings:
            for start, end in itertools.pairwise(project(ring)):
                require_finite((*start, *end), where)
                if start != end:
                    drawing.add(Line(start, end, taken.material, height, thickness, where))
    else:
        drawing.report.dropped[told] += 1
        return
    drawing.report.kept[told] += 1


def _take_anchor(
    where: str,
    properties: Mapping[str, Any],
    part: shapely.Geometry,
    project: _Projection,
    drawing: Drawing,
) -> None:
    height = metres_of(where, properties, "height", math.nan)
    z = float(part.z) if part.has_z else height
    name = lowered(properties).get("name")
    label = name[:100] if isinstance(name, str) and name else f"pa{len(drawing.anchors_m) + 1}"
    drawing.anchors_m.append((label, (*project(part)[0], z if z > 0 else math.nan)))
    drawing.report.kept["Point as anchor"] += 1
