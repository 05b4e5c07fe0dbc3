"""Requests of the service: SI units, the unit in the name, nothing unknown accepted."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from estimator.arrays import AntennaArray, UniformLinearArray, UniformPlanarArray
from estimator.errors import InputError
from estimator.geometry import rotation_matrix
from estimator.measurements import AnchorPaths, Epoch, GaussianVrp
from estimator.slam.run import ENGINES, METHODS
from service.messages.names import plain_text

__all__ = [
    "ChannelsQuery",
    "Finite",
    "Flash",
    "Integer",
    "Name",
    "Number",
    "ReflectionPoint",
    "Request",
    "SessionRequest",
    "SiEpoch",
    "StartFrame",
    "SweepRequest",
    "Truth",
    "Wall",
]


def _number(value: object) -> object:
    """JSON's ``true`` and ``"1"`` are no numbers, its ``1.0`` is an integer."""
    if isinstance(value, (bool, str)):
        raise ValueError("expected a number")
    return value


Finite = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e9, le=1e9)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0, le=1e15)]
Integer = Annotated[int, BeforeValidator(_number)]
Number = Annotated[Integer, Field(ge=0, le=2**31 - 2)]
Name = Annotated[
    str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$"), AfterValidator(plain_text)
]
Title = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$"), AfterValidator(plain_text)]
Pair = Annotated[list[Finite], Field(fail_fast=True, min_length=2, max_length=2)]
Matrix = Annotated[list[Pair], Field(fail_fast=True, min_length=2, max_length=2)]


class Request(BaseModel):
    """Base: immutable, no unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class StartFrame(Request):
    """Where the agent started in the frame of a floor plan: maps are then given in that frame."""

    position_m: Pair
    heading_rad: Finite = 0.0


class SessionRequest(Request):
    """A new session: what is known and sensed, how inference is done, what to expect of the noise."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "name": "corridor, morning",
                    "method": "hybrid",
                    "engine": "gaussian",
                    "seed": 1,
                    "anchors": ["pa1", "pa2"],
                    "carrier_hz": 28e9,
                    "measurement_model": {"range_std_m": 0.1, "clutter_mean": 1.0},
                }
            ]
        }
    )

    name: Title = ""
    method: Annotated[str, Field(max_length=50, json_schema_extra={"enum": list(METHODS)})] = "hybrid"
    engine: Annotated[str, Field(max_length=50, json_schema_extra={"enum": list(ENGINES)})] = "gaussian"
    seed: Annotated[Integer, Field(ge=0, le=2**63 - 1)] = 0
    anchors: Annotated[list[Name], Field(fail_fast=True, min_length=1, max_length=1000)]
    carrier_hz: Positive
    measurement_model: Annotated[
        dict[Annotated[str, Field(max_length=100)], int | Finite], Field(max_length=100)
    ] = Field(default_factory=dict, description="Fields of the engine's configuration; the rest is default.")
    known_anchors_m: Annotated[list[Pair], Field(fail_fast=True, max_length=1000)] | None = Field(
        None, description="The anchors' places in the estimator's frame, for methods that know them."
    )
    start_frame: StartFrame | None = None

    @model_validator(mode="after")
    def _distinct(self) -> SessionRequest:
        if len(set(self.anchors)) != len(self.anchors):
            raise ValueError("anchors: expected names that differ")
        if self.known_anchors_m is not None and len(self.known_anchors_m) != len(self.anchors):
            raise ValueError(f"known_anchors_m: expected {len(self.anchors)} places, one an anchor")
        return self

    def config(self) -> dict[str, Any]:
        """What the session's engine is made from (JSON types)."""
        return self.model_dump(mode="json", exclude={"name"})


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


class Paths(Request):
    """The paths that one anchor was heard on: times of flight, their spread, gains, directions of arrival."""

    delay_s: Annotated[list[Positive], Field(fail_fast=True, max_length=10_000)]
    delay_std_s: Annotated[list[Positive], Field(fail_fast=True, max_length=10_000)] | None = None
    delay_variance_s2: Annotated[list[Positive], Field(fail_fast=True, max_length=10_000)] | None = None
    gain_db: Annotated[list[Finite], Field(fail_fast=True, max_length=10_000)] | None = None
    azimuth_rad: Annotated[list[Finite], Field(fail_fast=True, max_length=10_000)] | None = None
    azimuth_std_rad: Annotated[list[Positive], Field(fail_fast=True, max_length=10_000)] | None = None

    @model_validator(mode="after")
    def _one_spread(self) -> Paths:
        if (self.delay_std_s is None) == (self.delay_variance_s2 is None):
            raise ValueError("expected one of delay_std_s and delay_variance_s2")
        return self

    def anchor_paths(self) -> AnchorPaths:
        """The paths in the estimator's terms."""
        std = self.delay_std_s
        spread = np.sqrt(np.array(self.delay_variance_s2)) if std is None else np.array(std)
        optional = (self.gain_db, self.azimuth_rad, self.azimuth_std_rad)
        columns = (None if column is None else np.array(column) for column in optional)
        return AnchorPaths(np.array(self.delay_s), spread, *columns)


class SiEpoch(Request):
    """An epoch in SI units: for each anchor by name, its paths; an anchor left out was not heard."""

    epoch: Number
    time_s: Finite
    anchors: Annotated[dict[Name, Paths], Field(max_length=1000)]
    sweep: Annotated[list[Wall], Field(fail_fast=True, max_length=1000)] = Field(
        default_factory=list, description="Walls that a beam sweep at this epoch saw, relative to the agent."
    )
    heading_held: bool = Field(
        True, strict=True, description="Whether the agent's axes are still those of the start."
    )

    def estimator_epoch(self, names: list[str]) -> Epoch:
        """The epoch in the estimator's terms.

        Raises
        ------
        InputError
            If an anchor is none of the session's, or columns differ in length.
        """
        unknown = sorted(set(self.anchors) - set(names))
        if unknown:
            raise InputError(
                f"epoch {self.epoch}: expected anchors among {', '.join(names)}, got {unknown[0]!r}"
            )
        paths = []
        for name in names:
            given = self.anchors.get(name)
            try:
                paths.append(AnchorPaths(np.zeros(0), np.zeros(0)) if given is None else given.anchor_paths())
            except InputError as error:
                raise InputError(f"epoch {self.epoch}, anchor {name}: {error}") from error
        sweep = tuple(wall.gaussian() for wall in self.sweep)
        return Epoch(self.epoch, self.time_s, tuple(paths), sweep, self.heading_held)


class ChannelsQuery(Request):
    """What raw channels do not tell of themselves; the array in the words of a dataset's manifest."""

    noise_variance: Annotated[
        float, Field(gt=0.0, le=1e6, allow_inf_nan=False, description="Of the channels' noise, per tone.")
    ]
    elements: Annotated[int, Field(ge=2, le=1024)] | None = Field(
        None, description="Of the agent's array, in a row; without it nothing is known of several antennas."
    )
    rows: Annotated[int, Field(ge=1, le=64)] = 1
    spacing_wavelengths: Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)] = 0.5
    row_spacing_wavelengths: Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)] = 0.5
    boresight_rad: Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)] = 0.0
    lying: bool = Field(False, description="Whether rows are one ahead of, not above, the other.")
    orientation: Literal["fixed", "travel"] = Field(
        "fixed", description="Whether the agent keeps its axes or turns them with its track."
    )

    def array(self) -> AntennaArray | None:
        """The agent's array, if it was described."""
        if self.elements is None:
            return None
        if self.rows == 1:
            return UniformLinearArray(self.elements, self.spacing_wavelengths, self.boresight_rad)
        return UniformPlanarArray(
            self.rows,
            self.elements,
            self.row_spacing_wavelengths,
            self.spacing_wavelengths,
            self.boresight_rad,
            self.lying,
        )


class TruthWall(Request):
    """A true wall as a segment."""

    name: Annotated[str, Field(max_length=100), AfterValidator(plain_text)] = ""
    from_m: Pair
    to_m: Pair


class Truth(Request):
    """The truth, for comparison on the page alone; in the estimator's frame, or in the start frame's."""

    frame: Literal["estimator", "plan"] = "plan"
    walls: Annotated[list[TruthWall], Field(fail_fast=True, max_length=10_000)] = Field(default_factory=list)
    anchors_m: Annotated[list[Pair], Field(fail_fast=True, max_length=1000)] = Field(default_factory=list)
    track_m: Annotated[list[Pair], Field(fail_fast=True, max_length=200_000)] = Field(default_factory=list)
    start_frame: StartFrame | None = None
