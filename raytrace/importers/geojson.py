"""GeoJSON: lines and outlines as walls, points as anchors.

Properties of a feature that count: ``material`` (or ``class``, ``category``, ``type``,
``layer``, ``name``, searched for words as layers are), ``height_m`` or ``height``,
``thickness_m`` or ``thickness``, and ``role`` (``wall``, ``anchor``, ``track``,
``ignore``). Coordinates are degrees (RFC 7946) if they can be: a building spans less than
a tenth of a degree, and no room is smaller than a tenth of a metre.
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
from raytrace.importers.drawing import Drawing, Line, require_finite, require_size
from raytrace.importers.options import IGNORE, UNITS_M, ImportOptions
from raytrace.plan.materials import ITU_MATERIALS

__all__ = ["read_geojson"]

_NAMES = ("material", "class", "category", "feature_type", "type", "layer", "name")
_ROLES = ("wall", "anchor", "track", IGNORE)
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
    features = [
        (where, properties, part)
        for where, properties, geometry in _features(_parse(require_size(data)))
        for part in _parts(_geometry(where, geometry))
    ]
    drawing = Drawing()
    if not features:
        raise FileFormatError("features: expected at least one geometry, got none")
    project = _projection(features, options, drawing)
    for where, properties, part in features:
        _take(where, properties, part, project, options, drawing)
    if not drawing.lines:
        raise FileFormatError("features: expected lines or polygons that are walls, got none")
    return drawing


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


def _features(root: Any) -> Iterator[tuple[str, Mapping[str, Any], Any]]:
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
        if feature.get("geometry") is not None:  # null is allowed: a feature without a place
            yield where, properties or {}, feature["geometry"]


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
    role = properties.get("role", "anchor" if kind == "Point" and "anchor" in _name(properties) else "wall")
    if role not in _ROLES:
        raise FileFormatError(f"{where}.properties.role: expected one of {', '.join(_ROLES)}, got {role!r}")
    if role == "anchor" and kind == "Point":
        _take_anchor(where, properties, part, project, drawing)
        return
    if role == "track" and kind == "LineString":
        drawing.track_m = project(part)
        drawing.report.kept["LineString as track"] += 1
        return
    material = _material(where, properties, options)
    if role != "wall" or kind == "Point" or material == IGNORE:
        drawing.report.dropped[f"{kind} as {role}" + (", ignored" if material == IGNORE else "")] += 1
        return
    height = _metres(where, properties, "height", options.height_m)
    thickness = _metres(where, properties, "thickness", options.thickness_m)
    rings = [part] if kind == "LineString" or kind == "LinearRing" else [part.exterior, *part.interiors]
    for ring in rings:
        points = project(ring)
        for start, end in itertools.pairwise(points):
            require_finite((*start, *end), where)
            if start != end:
                drawing.add(Line(start, end, material, height, thickness, where))
    drawing.report.kept[f"{kind} as {material}"] += 1


def _take_anchor(
    where: str,
    properties: Mapping[str, Any],
    part: shapely.Geometry,
    project: _Projection,
    drawing: Drawing,
) -> None:
    height = _metres(where, properties, "height", math.nan)
    z = float(part.z) if part.has_z else height
    name = properties.get("name")
    label = name[:100] if isinstance(name, str) and name else f"pa{len(drawing.anchors_m) + 1}"
    drawing.anchors_m.append((label, (*project(part)[0], z if z > 0 else math.nan)))
    drawing.report.kept["Point as anchor"] += 1


def _name(properties: Mapping[str, Any]) -> str:
    return " ".join(str(properties[key]).lower() for key in _NAMES if key in properties)


def _material(where: str, properties: Mapping[str, Any], options: ImportOptions) -> str:
    stated = properties.get("material")
    if stated is not None and not isinstance(stated, str):
        raise FileFormatError(f"{where}.properties.material: expected a name, got {stated!r}")
    for key in _NAMES:
        if isinstance(properties.get(key), str):
            found = options.material_of(properties[key])
            if found is not None:
                return found
    if stated is not None:
        raise FileFormatError(
            f"{where}.properties.material: expected one of {', '.join(ITU_MATERIALS)}, got {stated!r}"
        )
    return "concrete"


def _metres(where: str, properties: Mapping[str, Any], name: str, default: float) -> float:
    for key in (f"{name}_m", name):
        if properties.get(key) is not None:
            value = properties[key]
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < 1000.0:
                raise FileFormatError(f"{where}.properties.{key}: expected metres above 0, got {value!r}")
            return float(value)
    return default
