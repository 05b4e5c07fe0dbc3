"""An epoch as NR positioning reports it: LPP of the handset, NRPPa of the network, or both."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from estimator.errors import InputError
from estimator.measurements import AnchorPaths, Epoch
from service.messages.fields import Finite, Number, Request
from service.messages.lpp import LppReport
from service.messages.nr_reports import FirstPath, TrpReport
from service.messages.nrppa import NrppaReport
from service.messages.terms import SessionTerms

__all__ = ["NrEpoch"]

_ARRIVALS = {"rtoa", "rstd"}  # times of arrival by one clock, not of flight


class NrEpoch(Request):
    """An epoch as LPP and NRPPa report it; a TRP left out was not heard.

    Without `time_s` its time is that of the first time stamp, whose frame number wraps after 10.24 s: the
    epoch is the first with that stamp after the epoch before.
    """

    epoch: Number
    time_s: Finite | None = Field(None, description="Instead of the time stamps' frame numbers.")
    lpp: LppReport | None = Field(None, description="ProvideLocationInformation of TS 37.355 V18.")
    nrppa: NrppaReport | None = Field(None, description="Measurement response of TS 38.455 V18.")
    heading_held: Annotated[bool, Field(strict=True)] = True

    @model_validator(mode="after")
    def _something(self) -> NrEpoch:
        if self.lpp is None and self.nrppa is None:
            raise ValueError("expected lpp, nrppa or both, got neither")
        return self

    @property
    def frame_time(self) -> bool:
        """Whether the epoch's time is known within the period of the system frame number alone."""
        return self.time_s is None

    def estimator_epoch(self, terms: SessionTerms) -> Epoch:
        """The epoch in the estimator's terms; its time as the stamp has it where none is given.

        Raises
        ------
        InputError
            If a TRP is none of the session's, came twice, tells no time of flight, or a time that is not
            positive.
        """
        heard: dict[int, TrpReport] = {}
        for source, ids in ((self.lpp, terms.dl_prs_ids), (self.nrppa, terms.trp_ids)):
            for given, report in source.reports() if source is not None else ():
                place = self._place(given, ids, source is self.lpp)
                known = heard.get(place)
                if known is not None and set(known.first) & set(report.first):
                    raise InputError(f"epoch {self.epoch}: expected each TRP once, got {given} a second time")
                heard[place] = report if known is None else known.joined(report)
        bias = self._bias_s(terms, heard.values())
        paths = []
        for place, name in enumerate(terms.anchors):
            if place not in heard:
                paths.append(AnchorPaths(np.zeros(0), np.zeros(0)))
                continue
            try:
                first = _flight(heard[place].first, bias)
                paths.append(heard[place].paths(first, terms.eirp(place)))
            except InputError as error:
                raise InputError(f"epoch {self.epoch}, anchor {name}: {error}") from error
        stamped = (self.lpp or self.nrppa) if self.time_s is None else None
        time_s = stamped.seconds() if stamped is not None else self.time_s
        assert time_s is not None
        return Epoch(self.epoch, time_s, tuple(paths), (), self.heading_held)

    def _bias_s(self, terms: SessionTerms, reports: Iterable[TrpReport]) -> float | None:
        """What the times of arrival of the epoch lack to be times of flight but for a free clock, seconds."""
        arrivals = [
            (kind, report.first[kind].seconds)
            for report in reports
            for kind in _ARRIVALS & report.first.keys()
        ]
        if terms.free_clock and len({kind for kind, _ in arrivals}) > 1:
            raise InputError(
                f"epoch {self.epoch}: expected times of arrival of one kind, UL-RTOA or RSTD, for each has a "
                "clock of its own; got both"
            )
        return terms.pseudorange_bias_s([seconds for _, seconds in arrivals])

    def _place(self, given: int, ids: Sequence[int], lpp: bool) -> int:
        if given not in ids:
            what, where = ("dl-PRS-ID-r16", "dl_prs_ids") if lpp else ("tRP-ID", "trp_ids")
            listed = ", ".join(map(str, ids)) or f"none: the session states no {where}"
            raise InputError(f"epoch {self.epoch}: expected {what} among {listed}, got {given}")
        return ids.index(given)


def _flight(first: Mapping[str, FirstPath], bias_s: float | None) -> FirstPath:
    """Time of flight from what was measured of the first path; raises InputError."""
    if "ue-rx-tx" in first and "gnb-rx-tx" in first:
        return first["ue-rx-tx"].half_sum(first["gnb-rx-tx"])
    if bias_s is not None and (arrivals := _ARRIVALS & first.keys()):
        (kind,) = arrivals
        return FirstPath(first[kind].seconds + bias_s, first[kind].std_s)
    if "rtoa" in first:
        return first["rtoa"]
    if "rstd" in first:
        raise InputError(
            "expected a time of flight, got a time difference of arrival (RSTD), which tells none: make the "
            'session with "nr": {"clock": "free"}, or send Multi-RTT of both ends, or UL-RTOA that counts '
            "from the time of transmission"
        )
    one, other = ("gNB", "NRPPa") if "ue-rx-tx" in first else ("handset's", "LPP")
    raise InputError(f"expected the Rx-Tx time differences of both ends, the {one} one ({other}) is missing")
