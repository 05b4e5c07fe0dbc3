"""A few paths traced for ``hapslam doctor``; run in a process of its own."""

from __future__ import annotations

import json
import time
from typing import Any

from raytrace.plan.files import parse_floorplan
from raytrace.propagation.backend import prepare
from raytrace.propagation.passive import trace_passive

__all__ = ["main", "probe"]

# A square room with one anchor: the line of sight and four reflections at both positions.
_ROOM: dict[str, Any] = {
    "format": "hapslam-floorplan",
    "version": 1,
    "name": "probe",
    "walls": [
        {"name": "south", "from_m": [0.0, 0.0], "to_m": [10.0, 0.0]},
        {"name": "east", "from_m": [10.0, 0.0], "to_m": [10.0, 10.0]},
        {"name": "north", "from_m": [10.0, 10.0], "to_m": [0.0, 10.0]},
        {"name": "west", "from_m": [0.0, 10.0], "to_m": [0.0, 0.0]},
    ],
    "anchors": [{"name": "pa1", "position_m": [7.0, 6.0, 2.5]}],
    "agent": {"waypoints_m": [[2.0, 3.0], [4.0, 3.0]], "smoothing_m": 0.0, "epochs": 2},
    "tracing": {"depth": 1},
}


def probe() -> dict[str, Any]:
    """Trace the room and tell what ran: variant, threads, paths found and expected, seconds."""
    prepare()
    import drjit
    import mitsuba

    start = time.perf_counter()
    _, report = trace_passive(parse_floorplan(_ROOM, source="probe"))
    return {
        "variant": mitsuba.variant(),
        "threads": drjit.thread_count(),
        "found": report.found,
        "expected": report.expected,
        "seconds": time.perf_counter() - start,
    }


def main() -> None:
    """Print :func:`probe` as one line of JSON."""
    print(json.dumps(probe()))  # noqa: T201
