"""Who sends and who listens: the anchors and the agent of a plan, and their clocks."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from raytrace.links import Count, Finite, NonNegative, Part, Positive, added

__all__ = ["Agent", "Anchor", "Clock", "Name", "Point2", "Point3"]

Point2 = Annotated[tuple[Finite, Finite], Field(strict=False)]
Point3 = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]
Name = Annotated[str, Field(min_length=1, max_length=100)]


class Clock(Part):
    """A clock: ``offset_s`` ahead at the first epoch, gaining ``drift_ppm`` microseconds a second."""

    offset_s: Finite = 0.0
    drift_ppm: Finite = 0.0

    def error_s(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """By how much the clock is ahead at times since the first epoch, same shape, seconds."""
        return np.asarray(self.offset_s + 1e-6 * self.drift_ppm * times_s)


class Anchor(Part):
    """A physical anchor: an isotropic, vertically polarised antenna, and a clock."""

    name: Name
    position_m: Point3
    clock: Clock = added(Clock())


class Agent(Part):
    """The agent's track: way-points smoothed by a moving average, sampled every ``step_m``.

    With the orientation ``fixed`` the axes of its arrays are turned by ``heading_deg``
    against the plan's all the way; with ``travel`` they turn with it, by ``heading_deg``
    against the direction of travel.
    """

    waypoints_m: Annotated[tuple[Point2, ...], Field(min_length=2, strict=False)]
    height_m: Positive = 1.5
    speed_m_s: Positive = 0.5
    step_m: Positive = 0.5
    epochs: Count = 236
    smoothing_m: NonNegative = 5.0
    heading_deg: Finite = 0.0
    orientation: Literal["fixed", "travel"] = added("fixed")
    clock: Clock = added(Clock())
