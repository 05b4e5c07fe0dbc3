"""Epochs in SI units."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch, Odometry
from service.messages.fields import Finite, Name, Number, Pair, Positive, Request
from service.messages.sweeps import Wall
from service.messages.terms import SessionTerms

__all__ = ["SiEpoch"]

Triple = Annotated[list[Finite], Field(fail_fast=True, min_length=3, max_length=3)]


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


class BodyMotion(Request):
    """Odometry: how the agent's body moved since the epoch before, in the axes that it had there."""

    displacement_m: Pair = Field(description="The way, x ahead, in the body's axes at the epoch before.")
    turn_rad: Finite = Field(description="By how much the body turned meanwhile, counter-clockwise.")
    covariance: Annotated[list[Triple], Field(fail_fast=True, min_length=3, max_length=3)] = Field(
        description="Of displacement (m, m) and turn (rad): symmetric, no eigenvalue negative."
    )


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
    asked: Annotated[list[Name], Field(fail_fast=True, max_length=1000)] | None = Field(
        None,
        description="Anchors measured to at this epoch, where not all: of others, silence says nothing.",
    )
    odometry: BodyMotion | None = None

    @property
    def frame_time(self) -> bool:
        """Whether the epoch's time is known within a frame number's period alone: it never is."""
        return False

    def estimator_epoch(self, terms: SessionTerms) -> Epoch:
        """The epoch in the estimator's terms.

        Raises
        ------
        InputError
            If an anchor is none of the session's, or columns differ in length.
        """
        names = terms.anchors
        unknown = sorted((set(self.anchors) | set(self.asked or ())) - set(names))
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
        asked = None if self.asked is None else tuple(name in self.asked for name in names)
        try:
            moved = None if self.odometry is None else Odometry(**self.odometry.model_dump())
        except InputError as error:
            raise InputError(f"epoch {self.epoch}: {error}") from error
        return Epoch(self.epoch, self.time_s, tuple(paths), sweep, self.heading_held, asked, moved)
