"""The shipped rooms, traced once for all tests."""

from __future__ import annotations

import pytest

from raytrace.floorplan import FloorPlan, load_floorplan
from raytrace.passive import TraceReport, trace_passive
from raytrace.paths import PathSet
from raytrace.scene import RadioScene, build_scene

Traced = tuple[FloorPlan, RadioScene, PathSet, TraceReport]


def _trace(name: str) -> Traced:
    plan = load_floorplan(name)
    radio = build_scene(plan, plan.radio.carrier_hz)
    return plan, radio, *trace_passive(plan, radio)


@pytest.fixture(scope="session")
def l_room() -> Traced:
    """Plan, scene, traced paths and report of the L-room."""
    return _trace("l-room")


@pytest.fixture(scope="session")
def hard_room() -> Traced:
    """The same of the L-room with floor, ceiling and scattering."""
    return _trace("l-room-hard")
