"""A map document as GeoJSON and as JSON-FG."""

from __future__ import annotations

from typing import Any

__all__ = ["feature_collection", "json_fg"]

_CONFORMANCE = "http://www.opengis.net/spec/json-fg-1/0.3/conf/core"


def feature_collection(document: dict[str, Any]) -> dict[str, Any]:
    """The GeoJSON of a map document; coordinates are metres of its frame, not degrees."""
    features = [
        _feature("LineString", wall["segment_m"], kind="wall", id=wall["id"], vrp_m=wall["vrp_m"])
        for wall in document["walls"]
    ]
    features += [
        _feature(
            "Point",
            anchor["position_m"],
            kind="anchor",
            name=anchor["name"],
            covariance_m2=anchor["covariance_m2"],
        )
        for anchor in document["anchors"]
        if anchor["located"]
    ]
    agent = document["agent"]
    features.append(
        _feature(
            "Point",
            agent["position_m"],
            kind="agent",
            covariance_m2=agent["covariance_m2"],
            integrity=document["integrity"],
        )
    )
    if len(document["track_m"]) > 1:
        features.append(_feature("LineString", document["track_m"], kind="track"))
    return {
        "type": "FeatureCollection",
        "frame": document["frame"],
        "epoch": document["epoch"],
        "time_s": document["time_s"],
        "features": features,
    }


def _feature(kind_of_geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": kind_of_geometry, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def json_fg(document: dict[str, Any], coordinate_id: str) -> dict[str, Any]:
    """The map as OGC Features and Geometries JSON: places in a local reference system, which it names.

    Parameters
    ----------
    document : dict
        A map document.
    coordinate_id : str
        Identifies the session, whose frame the coordinates are in, metres.
    """
    plain = feature_collection(document)
    return {
        "type": "FeatureCollection",
        "conformsTo": [_CONFORMANCE],
        "coordRefSys": f"urn:hapslam:crs:{coordinate_id}:{document['frame']}",
        "features": [
            {
                "type": "Feature",
                "id": f"{feature['properties']['kind']}-{number}",
                "featureType": feature["properties"]["kind"],
                "geometry": None,
                "place": feature["geometry"],
                "time": None,
                "properties": feature["properties"],
            }
            for number, feature in enumerate(plain["features"])
        ],
    }
