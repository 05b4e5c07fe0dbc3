"""Messages of NR positioning for tests: times of flight as the JSON of their elements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from service.messages.nr_reports import TC_INVERSE_HZ

SLOTS = 80  # of a frame at 120 kHz
QUALITY = {"timingQualityValue-r16": 1, "timingQualityResolution-r16": "mdot1"}


def steps(seconds: float, least_ticks: int, k: int) -> int:
    """The value that reports a time, by the tables of TS 38.133."""
    return int(np.floor((seconds * TC_INVERSE_HZ - least_ticks) / 2.0**k)) + 1


def middle_s(value: int, least_ticks: int, k: int) -> float:
    """The middle of the step that a value stands for, seconds."""
    return (least_ticks + (value - 0.5) * 2.0**k) / TC_INVERSE_HZ


def stamp(time_s: float) -> tuple[int, int]:
    """Frame number and slot of a time, at 120 kHz."""
    slot = round(time_s * 100 * SLOTS)
    return slot // SLOTS % 1024, slot % SLOTS


def lpp_element(
    prs: int, kind: str, first_s: float, later_s: Sequence[float], time_s: float
) -> dict[str, Any]:
    """An element of a measurement list: its first path by `kind`, the others relative to it, at k = -3."""
    frame, slot = stamp(time_s)
    return {
        "dl-PRS-ID-r16": prs,
        "nr-TimeStamp-r16": {
            "dl-PRS-ID-r16": prs,
            "nr-SFN-r16": frame,
            "nr-Slot-r16": {"scs120-r16": slot},
        },
        kind: {"kMinus3-r18": steps(first_s, -985_024, -3)},
        "nr-TimingQuality-r16": QUALITY,
        "nr-AdditionalPathListExt-r17": [
            {"nr-RelativeTimeDifference-r16": {"kMinus3-r18": steps(beyond, -8175, -3)}} for beyond in later_s
        ],
    }


def rtoa_item(trp: int, first_s: float, later_s: Sequence[float], time_s: float) -> dict[str, Any]:
    """An item of a measurement response with UL-RTOA at k = 0 and up to two more paths."""
    frame, slot = stamp(time_s)
    return {
        "tRP-ID": trp,
        "measurementResult": [
            {
                "measuredResultsValue": {
                    "uL-RTOA": {
                        "uLRTOAmeas": {"k0": steps(first_s, -985_024, 0)},
                        "additionalPathList": [
                            {"relativeTimeOfPath": {"k0": steps(beyond, -8175, 0)}} for beyond in later_s[:2]
                        ],
                    }
                },
                "timeStamp": {"systemFrameNumber": frame, "slotIndex": {"sCS-120": slot}},
                "measurementQuality": {
                    "timingMeasQuality": {"measurementQuality": 1, "resolution": "m0dot1"}
                },
            }
        ],
    }
