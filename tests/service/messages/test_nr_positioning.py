"""LPP and NRPPa: the published ASN.1 and ours are one; values mean what TS 38.133 says."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimator.errors import FileFormatError, InputError
from estimator.measurements import Epoch
from estimator.waveform import SPEED_OF_LIGHT_M_S
from service.messages.asn1 import decoded
from service.messages.lpp import LppReport
from service.messages.nr_epoch import NrEpoch
from service.messages.nr_reports import ADDITIONAL_PATHS, TC_INVERSE_HZ, TIMES, power_dbm
from service.messages.nrppa import NrppaReport
from service.messages.terms import SessionTerms
from tests.service.messages.nr_messages import lpp_element, middle_s, rtoa_item

TERMS = SessionTerms(("pa1", "pa2"), trp_ids=(7, 8), dl_prs_ids=(3, 4), eirp_dbm=(20.0, 23.0))


def lpp_message(information: dict[str, Any]) -> bytes:
    """An LPP-Message in UPER, by the published ASN.1."""
    pytest.importorskip("pycrate_asn1dir", reason="pycrate (hapslam[3gpp]) is not installed")
    from pycrate_asn1dir.LPP import LPP_PDU_Definitions

    message = LPP_PDU_Definitions.LPP_Message
    wrapped = {"criticalExtensions": {"c1": {"provideLocationInformation-r9": information}}}
    content = {"endTransaction": True, "lpp-MessageBody": {"c1": {"provideLocationInformation": wrapped}}}
    message.from_jer(json.dumps(content))
    return bytes(message.to_uper())


def chosen(value: Any) -> Any:
    """JSON elements as pycrate's values: an object whose one member is an alternative is a pair."""
    alternatives = ("uL-", "k", "sCS", "timingMeas", "choice", "Extended", "Reporting", "gNB")
    if isinstance(value, dict):
        ((name, content),) = value.items() if len(value) == 1 else (("", None),)
        if name.startswith(alternatives):
            return name, chosen(content)
        return {name: chosen(content) for name, content in value.items()}
    return [chosen(entry) for entry in value] if isinstance(value, list) else value


def nrppa_message(items: list[dict[str, Any]]) -> bytes:
    """An NRPPA-PDU with a measurement response in APER, by the published ASN.1."""
    pytest.importorskip("pycrate_asn1dir", reason="pycrate (hapslam[3gpp]) is not installed")
    from pycrate_asn1dir.NRPPa import NRPPA_PDU_Descriptions

    elements = [
        {"id": 39, "criticality": "reject", "value": ("Measurement-ID", 1)},
        {"id": 40, "criticality": "reject", "value": ("Measurement-ID", 2)},
        {"id": 42, "criticality": "reject", "value": ("TRP-MeasurementResponseList", chosen(items))},
    ]
    outcome = {
        "procedureCode": 11,
        "criticality": "reject",
        "nrppatransactionID": 7,
        "value": ("MeasurementResponse", {"protocolIEs": elements}),
    }
    pdu = NRPPA_PDU_Descriptions.NRPPA_PDU
    pdu.set_val(("successfulOutcome", outcome))
    return bytes(pdu.to_aper())


def test_lpp_is_the_published_one() -> None:
    """What LPP's ASN.1 encodes and decodes is read as the JSON that went in, element by element."""
    kinds = {
        "nr-Multi-RTT": ("nr-UE-RxTxTimeDiff-r16", {}),
        "nr-DL-TDOA": ("nr-RSTD-r16", {"dl-PRS-ReferenceInfo-r16": {"dl-PRS-ID-r16": 4}}),
    }
    for method, (kind, more) in kinds.items():
        element = lpp_element(3, kind, 3.1e-7, [1.2e-7, 2.5e-7], 1.25)
        element["nr-DL-PRS-FirstPathRSRP-Result-r17"] = 70
        element["nr-AdditionalPathListExt-r17"][0]["nr-DL-PRS-RSRPP-r17"] = 60
        report = {f"{method}-SignalMeasurementInformation-r16": {f"{method}-MeasList-r16": [element], **more}}
        body = lpp_message({f"{method}-ProvideLocationInformation-r16": report})
        found = decoded("lpp", body)
        assert found == report
        assert LppReport.model_validate(found).reports() == LppReport.model_validate(report).reports()
        place, read = LppReport.model_validate(report).reports()[-1]
        assert (place, read.power_dbm) == (3, -86.5)
        assert read.later[0][2] == -96.5
        (first,) = read.first.values()
        assert abs(first.seconds - 3.1e-7) <= 2.0**-4 / TC_INVERSE_HZ
        assert abs(read.later[1][0] - 2.5e-7) <= 2.0**-4 / TC_INVERSE_HZ
        assert LppReport.model_validate(report).seconds() == 1.25


def test_nrppa_is_the_published_one() -> None:
    """What NRPPa's ASN.1 encodes and decodes is read as the JSON that went in, with its later extensions."""
    item = rtoa_item(7, 2.0e-7, [1.2e-7], 1.25)
    finer = {
        "id": 149,
        "criticality": "reject",
        "value": {"ReportingGranularitykminus3AdditionalPath": 70_000},
    }
    paths = [
        {"relativeTimeOfPath": {"k1": 4200}, "pathPower": {"firstPathRSRPP": 55}},
        {"relativeTimeOfPath": {"choice-Extension": finer}},
    ]
    extended = {"id": 77, "criticality": "ignore", "extensionValue": {"ExtendedAdditionalPathList": paths}}
    item["measurementResult"][0]["measuredResultsValue"]["uL-RTOA"]["iE-extensions"] = [extended]
    found = decoded("nrppa", nrppa_message([item]))
    assert found == {"TRP-MeasurementResponseList": [item]}
    report = NrppaReport.model_validate(found)
    ((trp, read),) = report.reports()
    assert trp == 7
    assert abs(read.first["rtoa"].seconds - 2.0e-7) <= 0.5 / TC_INVERSE_HZ
    assert [power for _, _, power in read.later] == [-101.5, None]
    assert read.later[0][0] == middle_s(4200, -8175, 1)
    assert read.later[1][0] == middle_s(70_000, -8175, -3)
    assert report.seconds() == 1.25


def test_reported_ranges_are_the_published_ones() -> None:
    """The largest value of each granularity is the first that the table calls beyond."""
    pytest.importorskip("pycrate_asn1dir", reason="pycrate (hapslam[3gpp]) is not installed")
    from pycrate_asn1dir.LPP import LPP_PDU_Definitions

    element = LPP_PDU_Definitions.NR_DL_TDOA_MeasElement_r16
    path = LPP_PDU_Definitions.NR_AdditionalPath_r16
    for table, choice in (
        (TIMES, element._cont["nr-RSTD-r16"]),
        (ADDITIONAL_PATHS, path._cont["nr-RelativeTimeDifference-r16"]),
    ):
        for name, integer in choice._cont.items():
            k = int(name[1:2]) if name.startswith("k") and name[1].isdigit() else -int(name[6])
            (most,) = (entry.ub for entry in integer._const_val.root)
            assert table.seconds(k, most - 1, name)[0] * TC_INVERSE_HZ < table.most_ticks
            for beyond in (0, most):
                with pytest.raises(InputError, match="stands for all beyond"):
                    table.seconds(k, beyond, name)


def test_values_mean_what_their_tables_say() -> None:
    """A step of k = 0 is half a nanosecond wide and known to a part of it; powers are steps of a decibel."""
    zero, std = TIMES.seconds(0, 985_025, "RSTD")  # 0 <= RSTD < 1 Tc
    assert zero == 0.5 / TC_INVERSE_HZ
    assert std == pytest.approx(1.0 / TC_INVERSE_HZ / np.sqrt(12))
    assert TIMES.seconds(5, 1, "RSTD")[0] == (-985_024 + 16) / TC_INVERSE_HZ
    assert [power_dbm(value) for value in (0, 1, 125, 126)] == [None, -155.5, -31.5, None]


def test_round_trips_of_both_ends_are_times_of_flight() -> None:
    """The handset's and the network's Rx-Tx differences of a TRP, known by either identity, are joined."""
    flight, turn = 1.9e-7, 3.0e-4
    element = lpp_element(4, "nr-UE-RxTxTimeDiff-r16", 2 * flight + turn, [5e-8], 0.5)
    network = rtoa_item(8, 0.0, [], 0.5)
    value = network["measurementResult"][0]["measuredResultsValue"]
    ticks = int(np.floor(-turn * TC_INVERSE_HZ + 985_024)) + 1
    value["gNB-RxTxTimeDiff"] = {"rxTxTimeDiff": {"k0": ticks}}
    del value["uL-RTOA"]
    lpp = {"nr-Multi-RTT-SignalMeasurementInformation-r16": {"nr-Multi-RTT-MeasList-r16": [element]}}
    nrppa = {"TRP-MeasurementResponseList": [network]}
    epoch = NrEpoch.model_validate({"epoch": 0, "lpp": lpp, "nrppa": nrppa}).estimator_epoch(TERMS)
    heard = epoch.paths[1]
    assert len(epoch.paths[0]) == 0
    assert heard.delay_s[0] == pytest.approx(flight, abs=0.5 / TC_INVERSE_HZ)
    assert heard.delay_s[1] - heard.delay_s[0] == pytest.approx(5e-8, abs=2.0**-4 / TC_INVERSE_HZ)
    assert epoch.time_s == 0.5
    with pytest.raises(InputError, match=r"both ends, the gNB one \(NRPPa\) is missing"):
        NrEpoch.model_validate({"epoch": 0, "lpp": lpp}).estimator_epoch(TERMS)


def test_gains_come_of_powers_where_the_eirp_is_known() -> None:
    """RSRPP of all paths less the EIRP is the gain; where a power is missing there is none."""
    item = rtoa_item(7, 2.0e-7, [], 0.0)
    heard = NrEpoch.model_validate({"epoch": 0, "nrppa": {"TRP-MeasurementResponseList": [item]}})
    assert heard.estimator_epoch(TERMS).paths[0].gain_db is None
    element = lpp_element(3, "nr-UE-RxTxTimeDiff-r16", 4e-7, [5e-8], 0.0)
    element["nr-DL-PRS-FirstPathRSRP-Result-r17"] = 70
    element["nr-AdditionalPathListExt-r17"][0]["nr-DL-PRS-RSRPP-r17"] = 60
    item["measurementResult"][0]["measuredResultsValue"] = {
        "gNB-RxTxTimeDiff": {"rxTxTimeDiff": {"k0": 985_025}}
    }
    lpp = {"nr-Multi-RTT-SignalMeasurementInformation-r16": {"nr-Multi-RTT-MeasList-r16": [element]}}
    both = {"epoch": 0, "lpp": lpp, "nrppa": {"TRP-MeasurementResponseList": [item]}}
    gains = NrEpoch.model_validate(both).estimator_epoch(TERMS).paths[0].gain_db
    assert gains is not None
    assert gains.tolist() == [-106.5, -116.5]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tRP-ID": 9}, "expected tRP-ID among 7, 8, got 9"),
        ({"measurementResult.0.measurementQuality": None}, "expected measurementQuality"),
        ({"measurementResult.0.measuredResultsValue.uL-RTOA.uLRTOAmeas": {"k9": 1}}, "expected one of k0"),
        (
            {"measurementResult.0.measuredResultsValue.uL-RTOA.uLRTOAmeas": {"k0": 0}},
            "all beyond; leave it out",
        ),
        ({"measurementResult.0.timeStamp.slotIndex": {"sCS-15": 10}}, "expected less than 10, got 10"),
        (
            {"measurementResult.0.measuredResultsValue": {"uL-AngleOfArrival": {"azimuthAoA": 5}}},
            "only an angle or a power; the engines know directions at the agent",
        ),
    ],
)
def test_refusals_say_what_to_send(change: dict[str, Any], message: str) -> None:
    """Unknown TRPs, times beyond their table and reports without times are refused by what was expected."""
    item = rtoa_item(7, 2.0e-7, [], 0.0)
    for path, value in change.items():
        *above, last = path.split(".")
        place: Any = item
        for name in above:
            place = place[int(name)] if name.isdigit() else place[name]
        place[last] = value
    with pytest.raises((ValueError, InputError), match=message):
        _read(item)


def _read(item: dict[str, Any]) -> Epoch:
    given = {"epoch": 0, "nrppa": {"TRP-MeasurementResponseList": [item]}}
    return NrEpoch.model_validate(given).estimator_epoch(TERMS)


def test_time_differences_and_beam_powers_are_refused_with_a_reason() -> None:
    """RSTD alone tells no time of flight, DL-AoD no time at all: the refusal says what would do."""
    element = lpp_element(3, "nr-RSTD-r16", 1e-8, [], 0.0)
    tdoa = {"dl-PRS-ReferenceInfo-r16": {"dl-PRS-ID-r16": 4}, "nr-DL-TDOA-MeasList-r16": [element]}
    lpp = {"nr-DL-TDOA-SignalMeasurementInformation-r16": tdoa}
    with pytest.raises(InputError, match=r"\(RSTD\), which tells none: make the session with"):
        NrEpoch.model_validate({"epoch": 0, "lpp": lpp}).estimator_epoch(TERMS)
    beams = {"nr-DL-AoD-SignalMeasurementInformation-r16": {"nr-DL-AoD-MeasList-r16": []}}
    with pytest.raises(ValueError, match=r"got only powers of beams \(DL-AoD\)"):
        NrEpoch.model_validate({"epoch": 0, "lpp": beams})


def test_time_differences_are_pseudo_ranges_where_the_clock_is_free() -> None:
    """Differences stay what they are, the reference TRP has one, and both kinds do not go together."""
    free = replace(TERMS, free_clock=True)
    element = lpp_element(3, "nr-RSTD-r16", -7e-8, [4e-8], 0.0)
    tdoa = {"dl-PRS-ReferenceInfo-r16": {"dl-PRS-ID-r16": 4}, "nr-DL-TDOA-MeasList-r16": [element]}
    given = {"epoch": 0, "lpp": {"nr-DL-TDOA-SignalMeasurementInformation-r16": tdoa}}
    one, other = NrEpoch.model_validate(given).estimator_epoch(free).paths
    step = 2.0**-3 / TC_INVERSE_HZ
    assert one.delay_s[0] > 0.0
    assert one.delay_s[0] - other.delay_s[0] == pytest.approx(-7e-8, abs=step)
    assert one.delay_s[1] - one.delay_s[0] == pytest.approx(4e-8, abs=step)
    later = {"TRP-MeasurementResponseList": [rtoa_item(8, 3.0e-7, [], 0.0)]}
    with pytest.raises(InputError, match="of one kind"):
        NrEpoch.model_validate({**given, "nrppa": later}).estimator_epoch(free)
    heard = NrEpoch.model_validate({"epoch": 0, "nrppa": later}).estimator_epoch(free).paths[1]
    assert heard.delay_s[0] == pytest.approx(10.0 / SPEED_OF_LIGHT_M_S)


def test_broken_messages_are_refused() -> None:
    """Messages cut short or changed are refused as such, whatever the decoder runs into."""
    report = {"nr-Multi-RTT-MeasList-r16": [lpp_element(3, "nr-UE-RxTxTimeDiff-r16", 3.1e-7, [1.2e-7], 1.0)]}
    information = {"nr-Multi-RTT-SignalMeasurementInformation-r16": report}
    whole = {
        "lpp": lpp_message({"nr-Multi-RTT-ProvideLocationInformation-r16": information}),
        "nrppa": nrppa_message([rtoa_item(7, 2e-7, [1e-7], 0.0)]),
    }
    rng = np.random.default_rng(3)
    refused = 0
    for protocol, body in whole.items():
        for _ in range(100):
            changed = bytearray(body[: rng.integers(0, len(body) + 1)] if rng.random() < 0.5 else body)
            for _ in range(rng.integers(0, 4)):
                if changed:
                    changed[rng.integers(len(changed))] = rng.integers(256)
            try:
                decoded(protocol, bytes(changed))  # type: ignore[arg-type]
            except FileFormatError:
                refused += 1
    assert refused > 50
