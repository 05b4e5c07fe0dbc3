"""Measurements of the network as NRPPa reports them (3GPP TS 38.455, V18): the JSON of its ASN.1 elements.

Of ``TRP-MeasurementResponseList`` UL-RTOA and gNB Rx-Tx time differences are read, with additional paths and
powers; UL-AoA is passed over beside them and refused alone, for the engines know directions at the agent, not
at the TRP. Elements that are not named here may be there and are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from estimator.errors import InputError
from service.messages.fields import Integer
from service.messages.lpp import Element, chosen
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

__all__ = ["NrppaReport"]

_SLOTS = {"sCS-15": 10, "sCS-30": 20, "sCS-60": 40, "sCS-120": 80}
_GRANULARITY = {f"k{k}": k for k in range(6)}
# ProtocolIE-ID of the extensions that are read (TS 38.455 section 9.3.7).
_EXTENDED_PATHS, _PATH_POWER = 77, 96
_FINER = {141 + k: -1 - k for k in range(6)}  # ReportingGranularitykminus1 to kminus6 of first paths
_FINER_PATHS = {147 + k: -1 - k for k in range(6)}  # and of additional paths


class Extension(Element):
    """``ProtocolExtensionField``: an element that came with a later version."""

    id: Annotated[Integer, Field(ge=0, le=65535)]
    value: Any = Field(None, alias="extensionValue")


class FinerTime(Element):
    """``ProtocolIE-Single-Container``: a time finer than ``Tc``."""

    id: Annotated[Integer, Field(ge=0, le=65535)]
    value: Any = None


Steps = Annotated[Integer, Field(ge=0, le=2**27)]
ScaledTime = Annotated[
    dict[str, Steps | FinerTime],
    Field(
        min_length=1,
        max_length=1,
        description="CHOICE of granularities k0 to k5, steps of 2^k Tc; finer ones as choice-extension.",
        json_schema_extra={
            "propertyNames": {"enum": [*_GRANULARITY, "choice-extension", "choice-Extension"]}
        },
    ),
]
Extensions = Annotated[list[Extension], Field(max_length=64)]


class TimingQuality(Element):
    """``TrpMeasurementTimingQuality``: one standard deviation as a length."""

    value: Annotated[Integer, Field(ge=0, le=31, alias="measurementQuality")]
    resolution: Literal["m0dot1", "m1", "m10", "m30"]


class MeasurementQuality(Element):
    """``TrpMeasurementQuality``."""

    timing: TimingQuality | None = Field(None, alias="timingMeasQuality")


class AdditionalPath(Element):
    """``AdditionalPathListItem`` or ``ExtendedAdditionalPathList-Item``: a path after the first."""

    beyond: ScaledTime = Field(alias="relativeTimeOfPath")
    quality: MeasurementQuality | None = Field(None, alias="pathQuality")
    power: Any = Field(None, alias="pathPower", description="UL-SRS-RSRPP, of extended lists.")
    extensions: Extensions = Field(default_factory=list, alias="iE-Extensions")


class TimedMeasurement(Element):
    """``UL-RTOAMeasurement`` or ``GNB-RxTxTimeDiff``."""

    rtoa: ScaledTime | None = Field(None, alias="uLRTOAmeas")
    difference: ScaledTime | None = Field(None, alias="rxTxTimeDiff")
    additional: Annotated[list[AdditionalPath], Field(max_length=8)] = Field(
        default_factory=list, alias="additionalPathList"
    )
    extensions: Extensions = Field(default_factory=list, alias="iE-extensions")
    more_extensions: Extensions = Field(default_factory=list, alias="iE-Extensions")

    def paths(self) -> Iterator[AdditionalPath]:
        """Additional paths, those of the extended list instead where there is one."""
        for extension in (*self.extensions, *self.more_extensions):
            if extension.id == _EXTENDED_PATHS:
                yield from map(AdditionalPath.model_validate, _content(extension.value))
                return
        yield from self.additional


class MeasuredResult(Element):
    """``TrpMeasuredResultsValue``: one of what can be measured."""

    rtoa: TimedMeasurement | None = Field(None, alias="uL-RTOA")
    rx_tx: TimedMeasurement | None = Field(None, alias="gNB-RxTxTimeDiff")
    angle: Any = Field(
        None, alias="uL-AngleOfArrival", description="Passed over beside times, refused alone."
    )


class TimeStamp(Element):
    """``TimeStamp``: system frame number and slot."""

    frame: Annotated[Integer, Field(ge=0, le=1023, alias="systemFrameNumber")]
    slot: Annotated[
        dict[str, Annotated[Integer, Field(ge=0, le=79)]],
        Field(
            min_length=1,
            max_length=1,
            alias="slotIndex",
            json_schema_extra={"propertyNames": {"enum": list(_SLOTS)}},
        ),
    ]

    @model_validator(mode="after")
    def _slot_in_frame(self) -> TimeStamp:
        slots, slot = chosen(self.slot, _SLOTS, "slotIndex")
        if slot >= slots:
            raise ValueError(f"slotIndex: expected less than {slots}, got {slot}")
        return self

    def seconds(self) -> float:
        """Time within the period of the system frame number, seconds."""
        slots, slot = chosen(self.slot, _SLOTS, "slotIndex")
        return frame_time_s(self.frame, slot, slots)


class MeasurementItem(Element):
    """``TrpMeasurementResultItem``."""

    measured: MeasuredResult = Field(alias="measuredResultsValue")
    time: TimeStamp = Field(alias="timeStamp")
    quality: MeasurementQuality | None = Field(None, alias="measurementQuality")

    @property
    def timed(self) -> TimedMeasurement | None:
        """What was measured, if it is a time."""
        return self.measured.rtoa or self.measured.rx_tx

    def report(self, trp: int) -> TrpReport:
        """The item, which has a time, in SI units; raises InputError."""
        try:
            return self._report(f"tRP-ID {trp}")
        except ValueError as error:  # of Pydantic, too, for extensions are read here
            raise InputError(str(error)) from error

    def _report(self, what: str) -> TrpReport:
        timed, kind = self.timed, "rtoa" if self.measured.rtoa else "gnb-rx-tx"
        assert timed is not None
        if self.quality is None or self.quality.timing is None:
            raise ValueError(f"{what}: expected measurementQuality with timingMeasQuality, got none")
        std = quality_std_s(self.quality.timing.value, self.quality.timing.resolution)
        reported = timed.rtoa if kind == "rtoa" else timed.difference
        if reported is None:
            raise ValueError(f"{what}: expected uLRTOAmeas or rxTxTimeDiff, got neither")
        first = _time(TIMES, reported, _FINER, std, what)
        later = tuple(_later(path, std, what) for path in timed.paths())
        return TrpReport({kind: first}, later)


class ResponseItem(Element):
    """``TRP-MeasurementResponseItem``: the results of one TRP."""

    trp_id: Annotated[Integer, Field(ge=1, le=65535, alias="tRP-ID")]
    results: Annotated[list[MeasurementItem], Field(min_length=1, max_length=64)] = Field(
        alias="measurementResult"
    )


class NrppaReport(Element):
    """What an NRPPa measurement response or report has (TS 38.455)."""

    trps: Annotated[list[ResponseItem], Field(min_length=1, max_length=64)] = Field(
        alias="TRP-MeasurementResponseList"
    )

    @model_validator(mode="after")
    def _with_times(self) -> NrppaReport:
        for trp in self.trps:
            if all(item.timed is None for item in trp.results):
                raise ValueError(
                    f"tRP-ID {trp.trp_id}: expected uL-RTOA or gNB-RxTxTimeDiff, got only an angle or a "
                    "power; the engines know directions at the agent, not at the TRP: send times, too"
                )
        return self

    def seconds(self) -> float:
        """Time of the first item, within the period of the system frame number, seconds."""
        return self.trps[0].results[0].time.seconds()

    def reports(self) -> list[tuple[int, TrpReport]]:
        """Reports by TRP identity."""
        return [
            (trp.trp_id, item.report(trp.trp_id))
            for trp in self.trps
            for item in trp.results
            if item.timed is not None
        ]


def _content(value: Any) -> Any:
    """The content of an open type: as it is, or under the name of its type."""
    return next(iter(value.values())) if isinstance(value, dict) and len(value) == 1 else value


def _time(
    table: ReportTable, reported: dict[str, int | FinerTime], finer: dict[int, int], std_s: float, what: str
) -> FirstPath:
    ((name, value),) = reported.items()
    if isinstance(value, FinerTime):
        k, steps = finer.get(value.id), _content(value.value)
        if k is None or not isinstance(steps, int):
            raise ValueError(
                f"{what}: expected a granularity of k0 to k5 or k-1 to k-6, got element {value.id}"
            )
    else:
        k, steps = chosen({name: value}, _GRANULARITY, what)
    seconds, step_std = table.seconds(k, steps, what)
    return FirstPath(seconds, float((std_s**2 + step_std**2) ** 0.5))


def _later(path: AdditionalPath, std_s: float, what: str) -> tuple[float, float, float | None]:
    timing = None if path.quality is None else path.quality.timing
    std = std_s if timing is None else quality_std_s(timing.value, timing.resolution)
    found = _time(ADDITIONAL_PATHS, path.beyond, _FINER_PATHS, std, f"{what}, relativeTimeOfPath")
    return found.seconds, found.std_s, _power(path.power, path.extensions)


def _power(power: Any, extensions: Sequence[Extension]) -> float | None:
    """``UL-SRS-RSRPP`` of a path, dBm."""
    given = [power, *(_content(extension.value) for extension in extensions if extension.id == _PATH_POWER)]
    for found in given:
        value = found.get("firstPathRSRPP") if isinstance(found, dict) else None
        if isinstance(value, int) and 0 <= value <= 126:
            return power_dbm(value)
    return None
