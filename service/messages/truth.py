"""The truth that a page shows beside the estimates."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from service.messages.fields import Pair, Request
from service.messages.names import plain_text
from service.messages.session_requests import StartFrame

__all__ = ["Truth"]


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
