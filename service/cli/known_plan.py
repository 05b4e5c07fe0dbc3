"""Floor plans that are known to a run: their walls in the estimator's frame, for `slam --floor-plan`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimator.errors import ConfigurationError

if TYPE_CHECKING:
    from estimator.measurements import GaussianVrp, MeasurementSet
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["walls_of_plan"]


def walls_of_plan(
    plan: str,
    measurements: MeasurementSet,
    start: str | None = None,
    heading_deg: float | None = None,
    std_m: float | None = None,
) -> tuple[GaussianVrp, ...]:
    """The walls of a floor plan about the start of a run.

    Parameters
    ----------
    plan : str
        Floor plan (TOML), the name of a shipped scene, or a drawing that ``scene import`` takes.
    measurements : MeasurementSet
        The run's measurements; if they were converted from a log, they say where the agent starts.
    start : str, optional
        Where that is, ``X,Y`` in the plan, metres; by default as the measurements say, or where the agent of
        the plan starts.
    heading_deg : float, optional
        Direction of the estimator's x axis in the plan, degrees; by default that of the plan's agent if it
        is its start that is taken, else 0.
    std_m : float, optional
        Standard deviation of the plan's walls, metres.

    Raises
    ------
    ConfigurationError
        If the start is no point, or nothing tells it.
    InputError
        If the plan cannot be read or used.
    """
    from estimator.known_walls import known_walls

    drawn, native = _loaded(plan)
    told = measurements.settings.get("start_m")
    heading = 0.0
    if start is not None:
        place = _point(start)
    elif told is not None:
        place = np.array(told, dtype=np.float64)
    elif native:
        place, heading = drawn.track()[0, :2], drawn.heading_rad
    else:
        raise ConfigurationError(
            "--start: expected X,Y in the floor plan, for neither the measurements nor the plan say where "
            "the agent starts"
        )
    if heading_deg is not None:
        heading = float(np.deg2rad(heading_deg))
    if std_m is None:
        return known_walls(*drawn.walls_m(), place, heading)
    return known_walls(*drawn.walls_m(), place, heading, std_m)


def _loaded(plan: str) -> tuple[FloorPlan, bool]:
    """The plan, and whether it says itself where its agent starts."""
    from raytrace.importers.convert import SUFFIXES, import_floorplan
    from raytrace.importers.imdf import is_imdf
    from raytrace.plan.files import load_floorplan

    path = Path(plan)
    if path.suffix.lower() in SUFFIXES or is_imdf(path):
        return import_floorplan(path).plan, False
    return load_floorplan(plan), True


def _point(text: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigurationError(f"--start: expected two numbers X,Y, got {text!r}") from error
    return np.array([x, y])
