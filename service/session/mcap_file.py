"""A run as an MCAP file with ROS 2 messages, which Foxglove and rosbag2 open.

``/agent/pose`` has each epoch's position with covariance (``geometry_msgs/msg/PoseWithCovarianceStamped``),
``/map`` walls, anchors and the track so far as markers (``visualization_msgs/msg/MarkerArray``).
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimator.geometry import rotation_matrix
from estimator.result import SlamResult
from service.session.mcap_schemas import MARKERS, POSE

__all__ = ["mcap_file"]

_FRAME = "map"
_SPHERE, _LINE_STRIP, _TEXT = 2, 4, 9  # types of visualization_msgs/msg/Marker
_WALL, _ANCHOR, _TRACK = (
    (0.1, 0.1, 0.1, 1.0),
    (0.8, 0.2, 0.1, 1.0),
    (0.1, 0.4, 0.8, 1.0),
)  # red, green, blue, alpha
_LINE_M, _POINT_M = 0.1, 0.4


def mcap_file(result: SlamResult, document: Mapping[str, Any], heading_rad: float) -> bytes:
    """The file.

    Parameters
    ----------
    result : SlamResult
        Estimates of all epochs, in the estimator's frame.
    document : mapping
        The map at the last epoch, as :func:`service.session.results.map_document` makes it; poses are
        given in its frame.
    heading_rad : float
        Rotation from the estimator's frame into that of the map.
    """
    from mcap_ros2.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    turn = rotation_matrix(heading_rad)
    covariances = turn @ result.agent_covariance[:, :2, :2] @ turn.T
    pose = writer.register_msgdef("geometry_msgs/msg/PoseWithCovarianceStamped", POSE)
    markers = writer.register_msgdef("visualization_msgs/msg/MarkerArray", MARKERS)
    for time_s, place, covariance in zip(result.time_s, document["track_m"], covariances, strict=True):
        stamp = _nanoseconds(float(time_s))
        message = _pose(stamp, place, covariance)
        writer.write_message("/agent/pose", pose, message, stamp, stamp)
    last = _nanoseconds(float(result.time_s[-1]))
    writer.write_message("/map", markers, {"markers": _markers(last, document)}, last, last)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def _nanoseconds(time_s: float) -> int:
    """Times before 0, which a session may begin at, are counted from there."""
    return max(0, round(1e9 * time_s))


def _header(stamp: int) -> dict[str, Any]:
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": _FRAME}


def _point(place: Sequence[float]) -> dict[str, float]:
    return {"x": float(place[0]), "y": float(place[1]), "z": 0.0}


def _pose(stamp: int, place: Sequence[float], covariance: Any) -> dict[str, Any]:
    full = np.zeros((6, 6))
    full[:2, :2] = covariance
    at = {"position": _point(place), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return {"header": _header(stamp), "pose": {"pose": at, "covariance": full.ravel().tolist()}}


def _markers(stamp: int, document: Mapping[str, Any]) -> list[dict[str, Any]]:
    found = [
        _marker(stamp, "walls", wall["id"], _LINE_STRIP, _WALL, points=wall["segment_m"])
        for wall in document["walls"]
    ]
    for number, anchor in enumerate(document["anchors"]):
        if anchor["located"]:
            place = anchor["position_m"]
            found.append(_marker(stamp, "anchors", number, _SPHERE, _ANCHOR, place))
            found.append(_marker(stamp, "names", number, _TEXT, _ANCHOR, place, text=anchor["name"]))
    state = document["integrity"]["state"]
    if state in ("doubtful", "lost"):
        at = document["agent"]["position_m"]
        found.append(_marker(stamp, "integrity", 0, _TEXT, _ANCHOR, at, text=state))
    found.append(_marker(stamp, "track", 0, _LINE_STRIP, _TRACK, points=document["track_m"]))
    return found


def _marker(
    stamp: int,
    space: str,
    number: int,
    kind: int,
    colour: tuple[float, float, float, float],
    place: Sequence[float] = (0.0, 0.0),
    points: Sequence[Sequence[float]] = (),
    text: str = "",
) -> dict[str, Any]:
    size = _LINE_M if points else _POINT_M
    return {
        "header": _header(stamp),
        "ns": space,
        "id": number,
        "type": kind,
        "action": 0,
        "pose": {"position": _point(place), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
        "scale": {"x": size, "y": size, "z": size},
        "color": dict(zip("rgba", colour, strict=True)),
        "lifetime": {"sec": 0, "nanosec": 0},
        "frame_locked": False,
        "points": [_point(place) for place in points],
        "colors": [],
        "texture_resource": "",
        "texture": {"header": _header(stamp), "format": "", "data": b""},
        "uv_coordinates": [],
        "text": text,
        "mesh_resource": "",
        "mesh_file": {"filename": "", "data": b""},
        "mesh_use_embedded_materials": False,
    }
