"""Epochs as requests bring them, in either vocabulary."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Discriminator, Field, Tag

from service.messages.lpp import LppEpoch
from service.messages.schemas import Request, SiEpoch

__all__ = ["EpochsRequest"]


def _vocabulary(value: Any) -> str:
    if isinstance(value, dict):
        return "lpp" if "trpMeasurementList" in value else "si"
    return "lpp" if isinstance(value, LppEpoch) else "si"


AnyEpoch = Annotated[
    Annotated[SiEpoch, Tag("si")] | Annotated[LppEpoch, Tag("lpp")], Discriminator(_vocabulary)
]


class EpochsRequest(Request):
    """One or many consecutive epochs, in SI units or in the vocabulary of LPP and NRPPa."""

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
                            "timeStamp": {"sfn": 0, "slot": 0},
                            "trpMeasurementList": [
                                {
                                    "trpId": "pa1",
                                    "toa": {"value": 12270, "k": -5},
                                    "timingQuality": {
                                        "timingQualityValue": 1,
                                        "timingQualityResolution": "mdot1",
                                    },
                                    "additionalPathList": [
                                        {"relativeTimeDifference": {"value": 4152, "k": -5}}
                                    ],
                                }
                            ],
                        }
                    ]
                },
            ]
        }
    )

    epochs: Annotated[list[AnyEpoch], Field(fail_fast=True, min_length=1, max_length=100_000)]
