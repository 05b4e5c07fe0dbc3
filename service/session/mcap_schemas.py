"""Definitions of the ROS 2 messages that are written, as a file carries them beside its messages."""

from __future__ import annotations

__all__ = ["MARKERS", "POSE"]

_TYPES = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": "\n".join(
        (
            "std_msgs/Header header",
            "string ns",
            "int32 id",
            "int32 type",
            "int32 action",
            "geometry_msgs/Pose pose",
            "geometry_msgs/Vector3 scale",
            "std_msgs/ColorRGBA color",
            "builtin_interfaces/Duration lifetime",
            "bool frame_locked",
            "geometry_msgs/Point[] points",
            "std_msgs/ColorRGBA[] colors",
            "string texture_resource",
            "sensor_msgs/CompressedImage texture",
            "visualization_msgs/UVCoordinate[] uv_coordinates",
            "string text",
            "string mesh_resource",
            "visualization_msgs/MeshFile mesh_file",
            "bool mesh_use_embedded_materials",
        )
    ),
}


def _definition(fields: str, *types: str) -> str:
    """A message's fields, and those of the types that it is made of."""
    rule = "=" * 80
    return "\n".join([fields, *(f"{rule}\nMSG: {name}\n{_TYPES[name]}" for name in types)]) + "\n"


POSE = _definition(
    "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose",
    "std_msgs/Header",
    "builtin_interfaces/Time",
    "geometry_msgs/PoseWithCovariance",
    "geometry_msgs/Pose",
    "geometry_msgs/Point",
    "geometry_msgs/Quaternion",
)
MARKERS = _definition(
    "visualization_msgs/Marker[] markers",
    *(name for name in _TYPES if name != "geometry_msgs/PoseWithCovariance"),
)
