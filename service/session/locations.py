"""An estimate as a location service of a 5G core gives it (`Nlmf_Location`, 3GPP TS 29.572, V18)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["location_data"]

_CONFIDENCE = 39  # per cent of a Gaussian in the plane within the ellipse of one standard deviation
_KM_H = 3.6
_MOST_KM_H = 2047


def location_data(document: Mapping[str, Any], coordinate_id: str) -> dict[str, Any]:
    """``LocationData`` of a map document: a local point with its uncertainty ellipse, and the velocity.

    Parameters
    ----------
    document : mapping
        As :func:`service.session.results.map_document` makes it.
    coordinate_id : str
        Names the local origin, ``coordinateId``.

    Returns
    -------
    dict
        Angles are degrees clockwise from the y axis, as the shape's definition has them from north.
    """
    agent = document["agent"]
    lengths, axes = np.linalg.eigh(np.array(agent["covariance_m2"]))
    minor, major = np.sqrt(np.maximum(lengths, 0.0)).tolist()
    x, y = agent["position_m"]
    vx, vy = agent["velocity_m_s"]
    return {
        "locationEstimate": {
            "shape": "LOCAL_2D_POINT_UNCERTAINTY_ELLIPSE",
            "localOrigin": {"coordinateId": coordinate_id},
            "point": {"x": x, "y": y},
            "uncertaintyEllipse": {
                "semiMajor": major,
                "semiMinor": minor,
                "orientationMajor": round(_bearing_deg(*axes[:, 1])) % 180,
            },
            "confidence": _CONFIDENCE,
        },
        "velocityEstimate": {
            "hSpeed": min(_KM_H * float(np.hypot(vx, vy)), _MOST_KM_H),
            "bearing": round(_bearing_deg(vx, vy)) % 360,
        },
    }


def _bearing_deg(x: float, y: float) -> float:
    return float(np.degrees(np.arctan2(x, y))) % 360.0
