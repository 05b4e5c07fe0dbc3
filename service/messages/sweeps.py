"""What active sensing saw, as requests bring it: walls, flashes, reflection points."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field

from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from service.messages.fields import Finite, Matrix, Number, Pair, Positive, Request

__all__ = ["Flash", "ReflectionPoint", "SweepRequest", "Wall"]


class Wall(Request):
    """A wall as a virtual reference point, the mirror image of the agent's start, with covariance."""

    vrp_m: Pair
    covariance_m2: Matrix

    def gaussian(self) -> GaussianVrp:
        """The wall in the estimator's terms."""
        return GaussianVrp(np.array(self.vrp_m), np.array(self.covariance_m2))


class Flash(Request):
    """A return at normal incidence: the wall stands at ``range_m`` in direction ``azimuth_rad``."""

    range_m: Positive
    range_std_m: Positive
    azimuth_rad: Finite
    azimuth_std_rad: Positive

    def gaussian(self) -> GaussianVrp:
        """The wall in the estimator's terms: the VRP is twice as far as the wall."""
        turn = rotation_matrix(self.azimuth_rad)
        along, across = 2.0 * self.range_std_m, 2.0 * self.range_m * self.azimuth_std_rad
        covariance = turn @ np.diag([along**2, across**2]) @ turn.T
        return GaussianVrp(2.0 * self.range_m * turn[:, 0], 0.5 * (covariance + covariance.T))


class ReflectionPoint(Request):
    """What one beam saw: a return from ``range_m`` in direction ``azimuth_rad``, of whatever wall."""

    range_m: Positive
    range_std_m: Positive
    azimuth_rad: Finite


class SweepRequest(Request):
    """What active sensing saw at the start: walls with covariances, flashes, or reflection points."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "sweep": 0,
                    "flashes": [
                        {
                            "range_m": 10.02,
                            "range_std_m": 0.05,
                            "azimuth_rad": 3.14,
                            "azimuth_std_rad": 0.003,
                        }
                    ],
                }
            ]
        }
    )

    sweep: Number = 0
    walls: Annotated[list[Wall], Field(fail_fast=True, max_length=1000)] = Field(default_factory=list)
    flashes: Annotated[list[Flash], Field(fail_fast=True, max_length=1000)] = Field(default_factory=list)
    points: Annotated[list[ReflectionPoint], Field(fail_fast=True, max_length=720)] = Field(
        default_factory=list,
        description="One a beam; walls are sought among them, and lines fitted through them.",
    )

    def gaussians(self) -> list[GaussianVrp]:
        """The walls and flashes in the estimator's terms, in the order given."""
        return [wall.gaussian() for wall in self.walls] + [flash.gaussian() for flash in self.flashes]
