"""What else is in the rooms: point targets, and bodies of people, vehicles and AGVs, still or on their way.

A *point* returns by the radar cross section that the plan states. A *body* has a size, shadows what
passes it, and, if it is of one of the kinds of 3GPP TR 38.901 (clause 7.9), returns by that kind's cross
section (:mod:`raytrace.radio.cross_sections`). Bodies stand on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from raytrace.plan.devices import Name, Point2, Point3
from raytrace.plan.links import Finite, Part, Positive, added

__all__ = ["KIND_SIZES_M", "Motion", "Target", "TargetKind"]

TargetKind = Literal["point", "human", "vehicle", "agv"]
Array = NDArray[np.float64]

# Length, width and height of the kinds, metres: tables of clause 7.9.1 (adult; AGV option 1), and vehicle
# type 2 of TR 37.885.
KIND_SIZES_M: dict[str, tuple[float, float, float]] = {
    "human": (0.5, 0.5, 1.75),
    "vehicle": (5.0, 2.0, 1.6),
    "agv": (0.5, 1.0, 0.5),
}


@dataclass(frozen=True, eq=False)
class Motion:
    """Where a target is at some times.

    Parameters
    ----------
    place_m : ndarray, shape (n, 3)
        A point's place, or where a body stands, metres.
    azimuth_rad : ndarray, shape (n,)
        Where its front looks, plan frame, radians.
    velocity_m_s : ndarray, shape (n, 3)
        Velocity, metres per second.
    """

    place_m: Array
    azimuth_rad: Array
    velocity_m_s: Array


class Target(Part):
    """A thing that echoes: furniture, a person, a vehicle; and, if it has a size, shadows.

    A ``point`` has a radar cross section, either ``rcs_m2`` in square metres or ``rcs_dbsm`` in decibels
    over one, which its ``points_m`` (in its own axes, x ahead) share evenly. It is heard in the echo alone,
    unless it has a ``size_m`` (length, width, height): then it also shadows, and scatters what anchors send.
    The kinds ``human``, ``vehicle`` and ``agv`` have sections and sizes of their own.

    It is at ``position_m``, or it goes along ``waypoints_m`` and back again, and so on, from the first epoch
    on; one way-point alone is where it stands. A point on its way is ``height_m`` above the floor. What
    stands looks to ``heading_deg``, what goes looks ahead.
    """

    name: Name
    position_m: Point3 | None = None
    rcs_m2: Positive | None = None
    rcs_dbsm: Finite | None = None
    kind: TargetKind = added("point")
    waypoints_m: Annotated[tuple[Point2, ...], Field(strict=False)] = added(())
    speed_m_s: Positive = added(1.0)
    height_m: Positive = added(1.0)
    heading_deg: Finite = added(0.0)
    points_m: Annotated[tuple[Point3, ...], Field(min_length=1, strict=False)] = added(((0.0, 0.0, 0.0),))
    size_m: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)] | None = added(None)

    @model_validator(mode="after")
    def _fits_together(self) -> Target:
        sections = sum(section is not None for section in (self.rcs_m2, self.rcs_dbsm))
        if self.kind == "point" and sections != 1:
            raise ValueError(f"expected either rcs_m2 or rcs_dbsm, got {'both' if sections else 'neither'}")
        if self.kind != "point" and (sections or self.points_m != ((0.0, 0.0, 0.0),)):
            raise ValueError(f"expected neither rcs_m2, rcs_dbsm nor points_m of a {self.kind}")
        if (self.position_m is None) == (not self.waypoints_m):
            came = "neither" if self.position_m is None else "both"
            raise ValueError(f"expected either position_m or waypoints_m, got {came}")
        if self.position_m is not None and self.kind != "point":
            raise ValueError(
                f"expected waypoints_m of a {self.kind} (one where it stands, on the floor), got position_m"
            )
        if any(
            before == after for before, after in zip(self.waypoints_m, self.waypoints_m[1:], strict=False)
        ):
            raise ValueError("expected waypoints_m that differ from one to the next")
        return self

    @property
    def section_m2(self) -> float:
        """Radar cross section of a point, square metres."""
        return self.rcs_m2 if self.rcs_m2 is not None else float(10.0 ** ((self.rcs_dbsm or 0.0) / 10.0))

    @property
    def body_m(self) -> tuple[float, float, float] | None:
        """Length, width and height of what shadows, metres; None of a mere point."""
        return self.size_m if self.size_m is not None else KIND_SIZES_M.get(self.kind)

    @property
    def foot_m(self) -> float:
        """Height of the lower end of the body above where :meth:`motion` has it, metres."""
        return 0.0 if self.kind != "point" else -self._place_height_m()

    def motion(self, times_s: Array) -> Motion:
        """Where it is at times (n,) since the first epoch, seconds."""
        count = len(times_s)
        height = self._place_height_m() if self.kind == "point" else 0.0
        plane = np.array(self.waypoints_m or [(self.position_m or (0.0, 0.0, 0.0))[:2]])
        if len(plane) == 1:
            return Motion(
                np.tile([*plane[0], height], (count, 1)),
                np.full(count, float(np.deg2rad(self.heading_deg))),
                np.zeros((count, 3)),
            )
        steps = np.diff(plane, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        reached = np.concatenate([[0.0], np.cumsum(lengths)])
        gone = np.mod(self.speed_m_s * times_s, 2.0 * reached[-1])
        back = gone >= reached[-1]
        gone = np.where(back, 2.0 * reached[-1] - gone, gone)
        # At a way-point the next piece counts: going forward the one that begins there.
        piece = np.searchsorted(reached, gone, side="right") - 1
        piece = np.clip(np.where(back & (gone == reached[piece]), piece - 1, piece), 0, len(steps) - 1)
        along = steps[piece] / lengths[piece, None]
        places = plane[piece] + (gone - reached[piece])[:, None] * along
        ahead = np.where(back, -1.0, 1.0)[:, None] * along
        return Motion(
            np.column_stack([places, np.full(count, height)]),
            np.arctan2(ahead[:, 1], ahead[:, 0]),
            self.speed_m_s * np.column_stack([ahead, np.zeros(count)]),
        )

    def _place_height_m(self) -> float:
        return self.height_m if self.position_m is None else self.position_m[2]
