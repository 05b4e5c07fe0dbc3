"""Measurements of a handset as LPP reports them (3GPP TS 37.355, V18): the JSON of its ASN.1 elements.

``NR-DL-TDOA-SignalMeasurementInformation-r16`` and ``NR-Multi-RTT-SignalMeasurementInformation-r16`` are
read, ``NR-DL-AoD-SignalMeasurementInformation-r16`` is refused, for it has powers of beams and no times.
Elements that are not named here may be there and are passed over.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.messages.fields import Integer
from service.messages.nr_reports import (
    ADDITIONAL_PATHS,
    TIMES,
    FirstPath,
    ReportTable,
    TrpReport,
    frame_time_s,
    power_dbm,
    quality_std_s,
)

__all__ = ["Element", "LppReport"]

_GRANULARITY = {f"k{k}-r16": k for k in range(6)} | {f"kMinus{k}-r18": -k for k in range(1, 7)}
_SLOTS = {"scs15-r16": 10, "scs30-r16": 20, "scs60-r16": 40, "scs120-r16": 80}
Power = Annotated[Integer, Field(ge=0, le=126)]
ScaledTime = Annotated[
    dict[str, Annotated[Integer, Field(ge=0, le=2**27)]],
    Field(
        min_length=1,
        max_length=1,
        description="CHOICE of k0-r16 to k5-r16 and kMinus1-r18 to kMinus6-r18: steps of 2^k Tc.",
        json_schema_extra={"propertyNames": {"enum": list(_GRANULARITY)}},
    ),
]


class Element(BaseModel):
    """Base: an ASN.1 element as JSON; what is not named is passed over."""

    model_config = ConfigDict(extra="ignore", frozen=True, serialize_by_alias=True)


def chosen(choice: dict[str, int], names: dict[str, int], what: str) -> tuple[int, int]:
    """Number of the chosen alternative and its value; raises ValueError if it is none of them."""
    ((name, value),) = choice.items()
    if name not in names:
        raise ValueError(f"{what}: expected one of {', '.join(names)}, got {name[:64]!r}")
    return names[name], value


class NrTimingQuality(Element):
    """``NR-TimingQuality-r16``: one standard deviation as a length."""

    value: Annotated[Integer, Field(ge=0, le=31, alias="timingQualityValue-r16")]
    resolution: Literal["mdot1", "m1", "m10", "m30"] = Field(alias="timingQualityResolution-r16")

    def std_s(self) -> float:
        """Standard deviation, seconds."""
        return quality_std_s(self.value, self.resolution)


class NrAdditionalPath(Element):
    """``NR-AdditionalPath-r16``: a path after the first."""

    beyond: ScaledTime = Field(alias="nr-RelativeTimeDifference-r16")
    quality: NrTimingQuality | None = Field(None, alias="nr-PathQuality-r16")
    power: Power | None = Field(None, alias="nr-DL-PRS-RSRPP-r17")

    @model_validator(mode="after")
    def _known_choice(self) -> NrAdditionalPath:
        chosen(self.beyond, _GRANULARITY, "nr-RelativeTimeDifference-r16")
        return self


class NrTimeStamp(Element):
    """``NR-TimeStamp-r16``: system frame number and slot."""

    frame: Annotated[Integer, Field(ge=0, le=1023, alias="nr-SFN-r16")]
    slot: Annotated[
        dict[str, Annotated[Integer, Field(ge=0, le=79)]],
        Field(
            min_length=1,
            max_length=1,
            alias="nr-Slot-r16",
            json_schema_extra={"propertyNames": {"enum": list(_SLOTS)}},
        ),
    ]

    @model_validator(mode="after")
    def _slot_in_frame(self) -> NrTimeStamp:
        slots, slot = chosen(self.slot, _SLOTS, "nr-Slot-r16")
        if slot >= slots:
            raise ValueError(f"nr-Slot-r16: expected less than {slots}, got {slot}")
        return self

    def seconds(self) -> float:
        """Time within the period of the system frame number, seconds."""
        slots, slot = chosen(self.slot, _SLOTS, "nr-Slot-r16")
        return frame_time_s(self.frame, slot, slots)


class _Measured(Element):
    """What the elements of both methods have in common."""

    prs_id: Annotated[Integer, Field(ge=0, le=255, alias="dl-PRS-ID-r16")]
    time: NrTimeStamp = Field(alias="nr-TimeStamp-r16")
    quality: NrTimingQuality = Field(alias="nr-TimingQuality-r16")
    additional: Annotated[list[NrAdditionalPath], Field(max_length=2)] = Field(
        default_factory=list, alias="nr-AdditionalPathList-r16"
    )
    more: Annotated[list[NrAdditionalPath], Field(max_length=8)] = Field(
        default_factory=list, alias="nr-AdditionalPathListExt-r17"
    )
    power: Power | None = Field(
        None,
        alias="nr-DL-PRS-FirstPathRSRP-Result-r17",
        description="RSRPP of the first path; the RSRP of all paths together is passed over.",
    )

    def report(self, kind: str, reported: dict[str, int], name: str) -> TrpReport:
        """The element in SI units; raises InputError where a time is beyond its table."""
        what = f"dl-PRS-ID-r16 {self.prs_id}, {name}"
        first = _time(TIMES, reported, self.quality.std_s(), what)
        later = tuple(
            (*_later(path, self.quality, what), None if path.power is None else power_dbm(path.power))
            for path in (*self.additional, *self.more)
        )
        return TrpReport({kind: first}, later, None if self.power is None else power_dbm(self.power))


def _time(table: ReportTable, reported: dict[str, int], std_s: float, what: str) -> FirstPath:
    k, value = chosen(reported, _GRANULARITY, what)
    seconds, step_std = table.seconds(k, value, what)
    return FirstPath(seconds, float((std_s**2 + step_std**2) ** 0.5))


def _later(path: NrAdditionalPath, quality: NrTimingQuality, what: str) -> tuple[float, float]:
    std = (path.quality or quality).std_s()
    found = _time(ADDITIONAL_PATHS, path.beyond, std, f"{what}, nr-RelativeTimeDifference-r16")
    return found.seconds, found.std_s


class NrDlTdoaMeasElement(_Measured):
    """``NR-DL-TDOA-MeasElement-r16``: time difference of arrival to the reference TRP."""

    rstd: ScaledTime = Field(alias="nr-RSTD-r16")

    @model_validator(mode="after")
    def _known_choice(self) -> NrDlTdoaMeasElement:
        chosen(self.rstd, _GRANULARITY, "nr-RSTD-r16")
        return self


class NrMultiRttMeasElement(_Measured):
    """``NR-Multi-RTT-MeasElement-r16``: the handset's Rx-Tx time difference."""

    difference: ScaledTime = Field(alias="nr-UE-RxTxTimeDiff-r16")

    @model_validator(mode="after")
    def _known_choice(self) -> NrMultiRttMeasElement:
        chosen(self.difference, _GRANULARITY, "nr-UE-RxTxTimeDiff-r16")
        return self


class DlPrsIdInfo(Element):
    """``DL-PRS-ID-Info-r16``: the reference TRP."""

    prs_id: Annotated[Integer, Field(ge=0, le=255, alias="dl-PRS-ID-r16")]


class NrDlTdoaInformation(Element):
    """``NR-DL-TDOA-SignalMeasurementInformation-r16``."""

    reference: DlPrsIdInfo = Field(alias="dl-PRS-ReferenceInfo-r16")
    elements: Annotated[list[NrDlTdoaMeasElement], Field(min_length=1, max_length=256)] = Field(
        alias="nr-DL-TDOA-MeasList-r16"
    )


class NrMultiRttInformation(Element):
    """``NR-Multi-RTT-SignalMeasurementInformation-r16``."""

    elements: Annotated[list[NrMultiRttMeasElement], Field(min_length=1, max_length=256)] = Field(
        alias="nr-Multi-RTT-MeasList-r16"
    )


class LppReport(Element):
    """What an LPP ``ProvideLocationInformation`` has of NR measurements (TS 37.355)."""

    tdoa: NrDlTdoaInformation | None = Field(None, alias="nr-DL-TDOA-SignalMeasurementInformation-r16")
    rtt: NrMultiRttInformation | None = Field(None, alias="nr-Multi-RTT-SignalMeasurementInformation-r16")
    aod: Any = Field(
        None,
        alias="nr-DL-AoD-SignalMeasurementInformation-r16",
        description="Refused: it has powers of beams and no times.",
    )

    @model_validator(mode="after")
    def _with_times(self) -> LppReport:
        if self.tdoa is None and self.rtt is None:
            got = "only powers of beams (DL-AoD)" if self.aod is not None else "neither"
            raise ValueError(
                "expected nr-DL-TDOA-SignalMeasurementInformation-r16 or "
                f"nr-Multi-RTT-SignalMeasurementInformation-r16, which have times, got {got}"
            )
        return self

    def seconds(self) -> float:
        """Time of the first element, within the period of the system frame number, seconds."""
        source = self.rtt or self.tdoa
        assert source is not None
        return source.elements[0].time.seconds()

    def reports(self) -> list[tuple[int, TrpReport]]:
        """Reports by PRS identity, the reference TRP's own of a TDOA at time zero first."""
        found: list[tuple[int, TrpReport]] = []
        if self.tdoa is not None:
            reference = self.tdoa.reference.prs_id
            if all(element.prs_id != reference for element in self.tdoa.elements):
                least = min(element.quality.std_s() for element in self.tdoa.elements)
                found.append((reference, TrpReport({"rstd": FirstPath(0.0, least)})))
            found += [
                (element.prs_id, element.report("rstd", element.rstd, "nr-RSTD-r16"))
                for element in self.tdoa.elements
            ]
        if self.rtt is not None:
            found += [
                (element.prs_id, element.report("ue-rx-tx", element.difference, "nr-UE-RxTxTimeDiff-r16"))
                for element in self.rtt.elements
            ]
        return found
