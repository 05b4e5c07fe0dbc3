"""Epochs as requests bring them, in either vocabulary."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Discriminator, Field, Tag

from service.messages.fields import Request
from service.messages.nr_epoch import NrEpoch
from service.messages.si_epoch import SiEpoch

__all__ = ["AnyEpoch", "EpochsRequest"]


def _vocabulary(value: Any) -> str:
    if isinstance(value, dict):
        return "nr" if {"lpp", "nrppa"} & value.keys() else "si"
    return "nr" if isinstance(value, NrEpoch) else "si"


AnyEpoch = Annotated[
    Annotated[SiEpoch, Tag("si")] | Annotated[NrEpoch, Tag("nr")], Discriminator(_vocabulary)
]


class EpochsRequest(Request):
    """One or many consecutive epochs, in SI units, or as LPP and NRPPa report them."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "epochs": [
                        {
                            "epoch": 0,
                            "time_s": 0.0,
                            "anchors": {
                                "pa1": {
                                    "delay_s": [1.95e-7, 2.61e-7],
                                    "delay_std_s": [3.3e-10, 3.3e-10],
                                    "gain_db": [-97.1, -104.8],
                                },
                                "pa2": {"delay_s": [1.28e-7], "delay_std_s": [3.3e-10], "gain_db": [-93.0]},
                            },
                        }
                    ]
                },
                {
                    "epochs": [
                        {
                            "epoch": 0,
                            "nrppa": {
                                "TRP-MeasurementResponseList": [
                                    {
                                        "tRP-ID": 1,
                                        "measurementResult": [
                                            {
                                                "measuredResultsValue": {
                                                    "uL-RTOA": {
                                                        "uLRTOAmeas": {"k0": 985408},
                                                        "additionalPathList": [
                                                            {"relativeTimeOfPath": {"k0": 8306}}
                                                        ],
                                                    }
                                                },
                                                "timeStamp": {
                                                    "systemFrameNumber": 0,
                                                    "slotIndex": {"sCS-120": 0},
                                                },
                                                "measurementQuality": {
                                                    "timingMeasQuality": {
                                                        "measurementQuality": 1,
                                                        "resolution": "m0dot1",
                                                    }
                                                },
                                            }
                                        ],
                                    }
                                ]
                            },
                        }
                    ]
                },
            ]
        }
    )

    epochs: Annotated[list[AnyEpoch], Field(fail_fast=True, min_length=1, max_length=100_000)]
