"""Who sends and who listens: anchors and agents of a plan."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from raytrace.plan.links import Count, Finite, NonNegative, Part, Positive, added

__all__ = ["Agent", "Anchor", "Clock", "FurtherAgent", "MeasuredMotion", "Name", "Point2", "Point3"]

Point2 = Annotated[tuple[Finite, Finite], Field(strict=False)]
Point3 = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]
Name = Annotated[str, Field(min_length=1, max_length=100)]

_SPEED_MARGIN = 1.5  # a device's largest speed over its speed, where a plan states none


class Clock(Part):
    """A clock: ``offset_s`` ahead at the first epoch, gaining ``drift_ppm`` microseconds a second."""

    offset_s: Finite = 0.0
    drift_ppm: Finite = 0.0

    def error_s(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """By how much the clock is ahead at times since the first epoch, same shape, seconds."""
        return np.asarray(self.offset_s + 1e-6 * self.drift_ppm * times_s)


class Anchor(Part):
    """A physical anchor, and its clock.

    Its array (``radio.anchor_array``) looks towards the azimuth ``boresight_deg`` of the
    plan, turned down from the horizontal by ``downtilt_deg``.
    """

    name: Name
    position_m: Point3
    boresight_deg: Finite = added(0.0)
    downtilt_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = added(0.0)
    clock: Clock = added(Clock())


class MeasuredMotion(Part):
    """The agent's odometry: standard deviations of what it measures from one epoch to the next.

    ``displacement_std_share`` is that of each component of the displacement, over its length;
    ``turn_std_rad`` that of the turn, radians.
    """

    displacement_std_share: NonNegative = 0.05
    turn_std_rad: NonNegative = 0.0175


class Agent(Part):
    """The agent's track: way-points smoothed by a moving average, sampled every ``step_m``.

    With the orientation ``fixed`` the axes of its arrays are turned by ``heading_deg``
    against the plan's all the way; with ``travel`` they turn with it, by ``heading_deg``
    against the direction of travel.

    ``max_speed_m_s`` is what the device knows of itself: it never moves faster. By default half as
    fast again as it moves. With a table ``odometry`` it measures how it moves.
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
    max_speed_m_s: Positive | None = added(None)
    odometry: MeasuredMotion | None = added(None)

    @model_validator(mode="after")
    def _is_no_faster(self) -> Agent:
        if self.max_speed_m_s is not None and self.max_speed_m_s < self.speed_m_s:
            raise ValueError(
                f"expected max_speed_m_s of at least speed_m_s = {self.speed_m_s:g}, "
                f"got {self.max_speed_m_s:g}"
            )
        return self

    @property
    def largest_speed_m_s(self) -> float:
        """The largest speed that the device knows of itself, metres per second."""
        return _SPEED_MARGIN * self.speed_m_s if self.max_speed_m_s is None else self.max_speed_m_s


class FurtherAgent(Agent):
    """Another agent in the same rooms, with the radio and echo of the first; its dataset has its name."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=60)]
