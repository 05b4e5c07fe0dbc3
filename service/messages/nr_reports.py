"""Reported values of NR positioning in SI units: times of ``2^k Tc``, powers, qualities, frame times.

What a report's integer means is a table of TS 38.133, the same in LPP (TS 37.355) and NRPPa (TS 38.455).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimator.errors import InputError
from estimator.measurements import AnchorPaths
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = [
    "ADDITIONAL_PATHS",
    "FRAME_PERIOD_S",
    "TC_INVERSE_HZ",
    "TIMES",
    "FirstPath",
    "ReportTable",
    "TrpReport",
    "frame_time_s",
    "power_dbm",
    "quality_std_s",
]

TC_INVERSE_HZ = 480_000 * 4096  # the basic time unit, TS 38.211 section 4.1
FRAME_PERIOD_S = 10.24  # of the system frame number, which counts to 1023
_METRES = {"mdot1": 0.1, "m0dot1": 0.1, "m1": 1.0, "m10": 10.0, "m30": 30.0}


@dataclass(frozen=True)
class ReportTable:
    """A table of reported times: value ``n`` of granularity ``k`` tells of a step ``2^k Tc`` wide.

    Parameters
    ----------
    least_ticks : int
        Where step 1 begins, ``Tc``; what is less is reported as 0.
    most_ticks : int
        From where on the largest value is reported.
    """

    least_ticks: int
    most_ticks: int

    def seconds(self, k: int, value: int, what: str) -> tuple[float, float]:
        """Middle of the step and its standard deviation, seconds.

        Raises
        ------
        InputError
            If the value is that for all times below or above the table.
        """
        last = (self.most_ticks - self.least_ticks) * 2 ** max(-k, 0) // 2 ** max(k, 0) + 1
        if not 0 < value < last:
            raise InputError(
                f"{what}: expected a time within the table, 1 to {last - 1} at k = {k}, got {value}, "
                "which stands for all beyond; leave it out"
            )
        step = 2.0**k
        return (self.least_ticks + (value - 0.5) * step) / TC_INVERSE_HZ, step / TC_INVERSE_HZ / np.sqrt(12.0)


# TS 38.133: RSTD (10.1.23), UE and gNB Rx-Tx time differences (10.1.25, 13.2), UL-RTOA (13.1), and their
# additional paths.
TIMES = ReportTable(-985_024, 985_024)
ADDITIONAL_PATHS = ReportTable(-8175, 8175)


def quality_std_s(value: int, resolution: str) -> float:
    """Standard deviation that a timing quality states, seconds; 0 means better than half a step."""
    return (value or 0.5) * _METRES[resolution] / SPEED_OF_LIGHT_M_S


def power_dbm(value: int) -> float | None:
    """Received power of a reference signal or a path (RSRP, RSRPP), dBm; None beyond the table.

    TS 38.133 section 10.1.24: value ``n`` from 1 to 125 is a step of 1 dB that ends at ``n - 156`` dBm.
    """
    return value - 156.5 if 0 < value < 126 else None


def frame_time_s(frame: int, slot: int, slots: int) -> float:
    """Time within the period of the system frame number, seconds: of a slot among those of a frame."""
    return frame / 100.0 + slot / (100.0 * slots)


@dataclass(frozen=True)
class FirstPath:
    """A time that was reported of the first path.

    Parameters
    ----------
    seconds, std_s : float
        The time and its standard deviation.
    """

    seconds: float
    std_s: float

    def half_sum(self, other: FirstPath) -> FirstPath:
        """Time of flight from the Rx-Tx time differences of both ends."""
        return FirstPath(0.5 * (self.seconds + other.seconds), 0.5 * float(np.hypot(self.std_s, other.std_s)))


@dataclass(frozen=True)
class TrpReport:
    """What one TRP and the agent measured of each other.

    Parameters
    ----------
    first : mapping of str to FirstPath
        By what was measured: ``"rtoa"``, ``"rstd"``, ``"ue-rx-tx"``, ``"gnb-rx-tx"``.
    later : tuple of (float, float, float or None)
        Of the paths after the first: delay beyond it and its standard deviation, seconds; power, dBm.
    power_dbm : float, optional
        Of the first path.
    """

    first: Mapping[str, FirstPath]
    later: tuple[tuple[float, float, float | None], ...] = ()
    power_dbm: float | None = None

    def joined(self, other: TrpReport) -> TrpReport:
        """The same TRP's reports of both ends; additional paths and power of whoever tells them first."""
        power = other.power_dbm if self.power_dbm is None else self.power_dbm
        return TrpReport({**other.first, **self.first}, self.later or other.later, power)

    def paths(self, first: FirstPath, eirp_dbm: float | None) -> AnchorPaths:
        """The paths in the estimator's terms; gains where all powers and the EIRP are known."""
        delays = [first.seconds, *(first.seconds + beyond for beyond, _, _ in self.later)]
        stds = [first.std_s, *(std for _, std, _ in self.later)]
        powers = [self.power_dbm, *(power for _, _, power in self.later)]
        gain = None
        if eirp_dbm is not None and None not in powers:
            gain = np.array(powers, dtype=np.float64) - eirp_dbm
        return AnchorPaths(np.array(delays), np.array(stds), gain)
