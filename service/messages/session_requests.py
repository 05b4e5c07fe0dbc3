"""What makes a session: what is known and sensed, how inference is done, what to expect of the noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from estimator.slam.methods import METHODS, PAIRS
from service.messages.fields import Finite, Integer, Name, Pair, Positive, Request, Title

__all__ = ["NrTerms", "SessionChange", "SessionRequest", "StartFrame"]


_ENGINES = list(dict.fromkeys(engine for _, engine in PAIRS))


class StartFrame(Request):
    """Where the agent started in the frame of a floor plan: maps are then given in that frame."""

    position_m: Pair
    heading_rad: Finite = 0.0


class NrTerms(Request):
    """What LPP and NRPPa call the anchors, and what is known of radio and clocks; one entry an anchor."""

    trp_ids: Annotated[list[Annotated[Integer, Field(ge=1, le=65535)]], Field(max_length=1000)] | None = (
        Field(None, description="tRP-ID of NRPPa (TS 38.455).")
    )
    dl_prs_ids: Annotated[list[Annotated[Integer, Field(ge=0, le=255)]], Field(max_length=256)] | None = (
        Field(None, description="dl-PRS-ID-r16 of LPP (TS 37.355).")
    )
    eirp_dbm: Annotated[list[Finite], Field(max_length=1000)] | None = Field(
        None, description="Radiated powers, with which RSRPP becomes channel gains."
    )
    clock: Literal["synchronised", "free"] = Field(
        "synchronised",
        description="`synchronised`: UL-RTOA counts from the time of transmission: a time of flight. "
        "`free`: times of arrival have an error common to all TRPs that is new in every epoch, as time "
        "differences (RSTD) do.",
    )
    clock_std_m: Positive = Field(
        40.0,
        description="Standard deviation of a free clock's error as a length, metres: how far the nearest "
        "TRP may be from the 10 m that it is first taken to be away.",
    )

    @model_validator(mode="after")
    def _distinct(self) -> NrTerms:
        for name in ("trp_ids", "dl_prs_ids"):
            given = getattr(self, name)
            if given is not None and len(set(given)) != len(given):
                raise ValueError(f"{name}: expected identities that differ")
        return self


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
    engine: Annotated[str, Field(max_length=50, json_schema_extra={"enum": _ENGINES})] = "gaussian"
    seed: Annotated[Integer, Field(ge=0, le=2**63 - 1)] = 0
    anchors: Annotated[list[Name], Field(fail_fast=True, min_length=1, max_length=1000)]
    carrier_hz: Positive
    measurement_model: Annotated[
        dict[Annotated[str, Field(max_length=100)], Annotated[int, Field(strict=True)] | Finite],
        Field(max_length=100),
    ] = Field(default_factory=dict, description="Fields of the engine's configuration; the rest is default.")
    known_anchors_m: Annotated[list[Pair], Field(fail_fast=True, max_length=1000)] | None = Field(
        None, description="The anchors' places in the estimator's frame, for methods that know them."
    )
    start_frame: StartFrame | None = None
    max_speed_m_s: Positive | None = Field(
        None, description="Largest speed of the device, metres a second, where it is known."
    )
    echo_bias_std_m: Annotated[Finite, Field(ge=0.0)] | None = Field(
        None, description="Standard deviation of an error in range that all echoes share, metres."
    )
    nr: NrTerms | None = Field(None, description="What epochs in the words of LPP and NRPPa are read by.")

    @model_validator(mode="after")
    def _distinct(self) -> SessionRequest:
        if len(set(self.anchors)) != len(self.anchors):
            raise ValueError("anchors: expected names that differ")
        if self.known_anchors_m is not None and len(self.known_anchors_m) != len(self.anchors):
            raise ValueError(f"known_anchors_m: expected {len(self.anchors)} places, one an anchor")
        for name in ("trp_ids", "dl_prs_ids", "eirp_dbm") if self.nr is not None else ():
            given = getattr(self.nr, name)
            if given is not None and len(given) != len(self.anchors):
                raise ValueError(f"nr.{name}: expected {len(self.anchors)}, one an anchor, got {len(given)}")
        return self

    def config(self) -> dict[str, Any]:
        """What the session's engine is made from (JSON types)."""
        return self.model_dump(mode="json", exclude={"name"})


class SessionChange(Request):
    """What of a session may change: its name; its anchors, with which a begun run is computed anew."""

    name: Title | None = None
    anchors: Annotated[list[Name], Field(fail_fast=True, min_length=1, max_length=1000)] | None = Field(
        None, description="All anchors: those that the session has, in their order, then others."
    )
    known_anchors_m: Annotated[list[Pair], Field(fail_fast=True, max_length=1000)] | None = None
    nr: NrTerms | None = None

    def changed(self, config: Mapping[str, Any]) -> SessionRequest:
        """The session's request with the changes; raises ValueError where they do not fit it."""
        known, given = config["anchors"], self.anchors
        if given is not None and given[: len(known)] != known:
            raise ValueError(f"anchors: expected {', '.join(known)} first, in this order, then others")
        stated = self.model_dump(mode="json", include=self.model_fields_set - {"name"}, exclude_none=True)
        return SessionRequest.model_validate({**config, **stated})

    @property
    def renames_only(self) -> bool:
        """Whether nothing but the name changes."""
        return not self.model_fields_set - {"name"}
