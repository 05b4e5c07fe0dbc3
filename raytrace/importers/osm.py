"""OpenStreetMap's XML: nodes and ways with their tags, read as the features of a map.

Closed ways are areas unless their tags say that they are walls, barriers or ways to walk on. Relations
(buildings with courtyards, sites) are left out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from estimator.errors import FileFormatError
from raytrace.importers.drawing import Drawing, require_size
from raytrace.importers.geojson import Feature, drawing_of
from raytrace.importers.options import ImportOptions
from raytrace.importers.safe_xml import parse_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["features_in", "read_osm"]

_LINES = ("wall", "door", "window")
_LINE_KEYS = ("barrier", "highway", "railway", "waterway")


def read_osm(data: bytes, options: ImportOptions) -> Drawing:
    """Read an OSM XML file (``.osm``).

    Raises
    ------
    FileFormatError
        If it is no such XML, has a document type or entities, names nodes that are not there, has
        several levels and none was chosen, or holds no wall.
    """
    drawing = drawing_of(features_in(data), options)
    drawing.report.notes.append("relations, if there are any, are left out")
    return drawing


def features_in(data: bytes) -> list[Feature]:
    """Nodes and ways with tags, as features; raises as :func:`read_osm`."""
    root = parse_xml(require_size(data))
    if root.tag != "osm":
        raise FileFormatError(f"expected an <osm>, got <{root.tag}>")
    nodes = {node.get("id", ""): _place(node) for node in root.iter("node")}
    features: list[Feature] = []
    for node in root.iter("node"):
        tags = _tags(node)
        if tags:
            point = {"type": "Point", "coordinates": nodes[node.get("id", "")]}
            features.append((f"node {node.get('id')}", tags, point))
    for way in root.iter("way"):
        where, tags = f"way {way.get('id')}", _tags(way)
        named = [ref.get("ref", "") for ref in way.findall("nd")]
        missing = next((name for name in named if name not in nodes), None)
        if missing is not None:
            raise FileFormatError(f"{where}: expected nodes that are in the file, node {missing!r} is not")
        if tags and len(named) > 1:
            features.append((where, tags, _geometry([nodes[name] for name in named], tags)))
    return features


def _place(node: Element) -> list[float]:
    """Longitude and latitude of a node, degrees."""
    try:
        place = [float(node.get("lon", "")), float(node.get("lat", ""))]
    except ValueError:
        place = [math.nan]
    if not all(map(math.isfinite, place)):
        raise FileFormatError(f"node {node.get('id')}: expected lon and lat in degrees, got {node.attrib}")
    return place


def _tags(element: Element) -> dict[str, Any]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.findall("tag")}


def _geometry(points: list[list[float]], tags: dict[str, Any]) -> dict[str, Any]:
    """A polygon if the way is closed and stands for an area, else a line."""
    line = tags.get("indoor") in _LINES or any(key in tags for key in _LINE_KEYS)
    if points[0] == points[-1] and len(points) > 3 and not line:
        return {"type": "Polygon", "coordinates": [points]}
    return {"type": "LineString", "coordinates": points}
