"""Epochs in the vocabulary of LPP (3GPP TS 37.355) and NRPPa (TS 38.455).

Times are integers in units of ``2^k Tc``, with ``Tc = 1 / (480000 * 4096)`` s, about 0.51 ns;
``k`` from -6 to 5. A TRP is an anchor, named by ``trpId``. The first path comes as a time of
flight (``toa``, as an UL-RTOA or a DL time of arrival with its known transmission time
removed) or as the Rx-Tx time differences of both ends, whose sum is the round trip;
further paths come relative to it. A time difference of arrival alone (RSTD) tells no time of
flight and is not accepted.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch
from estimator.waveform import SPEED_OF_LIGHT_M_S
from service.messages.schemas import Finite, Integer, Name, Number, Request

__all__ = ["TC_INVERSE_HZ", "LppEpoch", "TrpMeasurement"]

TC_INVERSE_HZ = 480_000 * 4096
_RESOLUTION_M = {"mdot1": 0.1, "m1": 1.0, "m10": 10.0, "m30": 30.0}

K = Annotated[Integer, Field(ge=-6, le=5)]
Ticks = Annotated[Integer, Field(ge=-(2**40), le=2**40)]


class ScaledTime(Request):
    """``value * 2^k * Tc``."""

    value: Ticks
    k: K = 0

    def seconds(self) -> float:
        """The time in seconds, correctly rounded."""
        return self.value * 2.0**self.k / TC_INVERSE_HZ


class TimingQuality(Request):
    """``timingQualityValue`` times the resolution: one standard deviation as a length."""

    timingQualityValue: Annotated[Integer, Field(ge=0, le=31)]
    timingQualityResolution: Literal["mdot1", "m1", "m10", "m30"]

    def std_s(self) -> float:
        """Standard deviation, seconds; 0 means better than half a step."""
        steps = self.timingQualityValue or 0.5
        return steps * _RESOLUTION_M[self.timingQualityResolution] / SPEED_OF_LIGHT_M_S


class AdditionalPath(Request):
    """A path after the first: by how much later, how well known, how strong."""

    relativeTimeDifference: ScaledTime
    pathQuality: TimingQuality | None = None
    rsrpp_dbm: Finite | None = None


class TrpMeasurement(Request):
    """What one TRP and the agent measured of each other."""

    trpId: Name
    toa: ScaledTime | None = None
    ueRxTxTimeDiff: ScaledTime | None = None
    gnbRxTxTimeDiff: ScaledTime | None = None
    timingQuality: TimingQuality
    rsrpp_dbm: Finite | None = None
    eirp_dbm: Finite | None = Field(None, description="With it, powers become channel gains.")
    additionalPathList: Annotated[list[AdditionalPath], Field(fail_fast=True, max_length=10_000)] = Field(
        default_factory=list
    )

    @model_validator(mode="after")
    def _one_first_path(self) -> TrpMeasurement:
        both = self.ueRxTxTimeDiff is not None and self.gnbRxTxTimeDiff is not None
        neither = self.ueRxTxTimeDiff is None and self.gnbRxTxTimeDiff is None
        if not (both if self.toa is None else neither):
            raise ValueError("expected either toa, or ueRxTxTimeDiff and gnbRxTxTimeDiff")
        return self

    def first_s(self) -> float:
        """Time of flight of the first path, seconds."""
        if self.toa is not None:
            return self.toa.seconds()
        assert self.ueRxTxTimeDiff is not None
        assert self.gnbRxTxTimeDiff is not None
        return 0.5 * (self.ueRxTxTimeDiff.seconds() + self.gnbRxTxTimeDiff.seconds())

    def anchor_paths(self) -> AnchorPaths:
        """The paths in the estimator's terms, in the order given."""
        first = self.first_s()
        delay = [first, *(first + path.relativeTimeDifference.seconds() for path in self.additionalPathList)]
        qualities = [path.pathQuality or self.timingQuality for path in self.additionalPathList]
        std = [quality.std_s() for quality in (self.timingQuality, *qualities)]
        powers = [self.rsrpp_dbm, *(path.rsrpp_dbm for path in self.additionalPathList)]
        gain = None
        if self.eirp_dbm is not None and None not in powers:
            gain = np.array(powers, dtype=np.float64) - self.eirp_dbm
        return AnchorPaths(np.array(delay), np.array(std), gain)


class TimeStamp(Request):
    """Frame and slot; with the hyper frame, times ascend for hours instead of 10.24 s."""

    hyperSfn: Annotated[Integer, Field(ge=0, le=1_000_000)] = 0
    sfn: Annotated[Integer, Field(ge=0, le=1023)]
    slot: Annotated[Integer, Field(ge=0, le=159)] = 0
    scs: Literal["kHz15", "kHz30", "kHz60", "kHz120"] = "kHz120"

    @model_validator(mode="after")
    def _slot_in_frame(self) -> TimeStamp:
        if self.slot >= self._slots:
            raise ValueError(f"slot: expected less than {self._slots} at {self.scs}, got {self.slot}")
        return self

    @property
    def _slots(self) -> int:
        return int(self.scs[3:]) * 10 // 15

    def seconds(self) -> float:
        """Seconds since the start of hyper frame 0."""
        return (1024 * self.hyperSfn + self.sfn) / 100 + self.slot / (100 * self._slots)


class LppEpoch(Request):
    """An epoch as lists of TRP measurements; a TRP left out was not heard."""

    epoch: Number
    timeStamp: TimeStamp
    trpMeasurementList: Annotated[list[TrpMeasurement], Field(fail_fast=True, max_length=1000)]

    def estimator_epoch(self, names: list[str]) -> Epoch:
        """The epoch in the estimator's terms.

        Raises
        ------
        InputError
            If a TRP is none of the session's anchors or comes twice, or a time of flight is
            not positive.
        """
        heard: dict[str, AnchorPaths] = {}
        for entry in self.trpMeasurementList:
            if entry.trpId not in names or entry.trpId in heard:
                why = "a second time" if entry.trpId in heard else "which is none of them"
                raise InputError(
                    f"epoch {self.epoch}: expected TRPs among {', '.join(names)}, got {entry.trpId!r}, {why}"
                )
            try:
                heard[entry.trpId] = entry.anchor_paths()
            except InputError as error:
                raise InputError(f"epoch {self.epoch}, TRP {entry.trpId}: {error}") from error
        silent = AnchorPaths(np.zeros(0), np.zeros(0))
        return Epoch(self.epoch, self.timeStamp.seconds(), tuple(heard.get(name, silent) for name in names))
