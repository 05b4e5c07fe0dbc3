"""From a log of channel responses to a log of ranges: the paths of each response, and their deviations.

Impulse responses are cut to a window about the device's first path, if it tells one, and become tones
(:mod:`estimator.channel.taps`); paths and tail are estimated (:mod:`estimator.channel.diffuse`). The range
that the device logged belongs to its first path, and other delays count from there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimator.channel.diffuse import DiffuseConfig, DiffusePlan
from estimator.channel.taps import tones_of_taps
from estimator.errors import ConfigurationError, InputError
from estimator.readers.range_log import RangeLog
from estimator.readers.response_files import ResponseLog
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = ["ResponseConfig", "ranges_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ResponseConfig:
    """How responses are taken.

    Parameters
    ----------
    window_taps : int
        Taps of the window of an impulse response: a tail of some hundred nanoseconds at 1 GHz.
    lead_taps : int
        Taps of it before the device's first path, which weaker paths may come before.
    first_only : bool
        Whether of each response the first path alone is told, as ranging does.
    diffuse : DiffuseConfig
        Settings of the estimation.
    """

    window_taps: int = 128
    lead_taps: int = 16
    first_only: bool = False
    diffuse: DiffuseConfig = field(default_factory=DiffuseConfig)

    def __post_init__(self) -> None:
        if self.window_taps < 2 or not 0 <= self.lead_taps < self.window_taps:
            raise ConfigurationError(
                "window_taps, lead_taps: expected a window and a part of it, "
                f"got {self.window_taps} and {self.lead_taps}"
            )


def ranges_of(log: ResponseLog, carrier_hz: float = 6e9, config: ResponseConfig | None = None) -> RangeLog:
    """The paths of a log's responses as ranges; a response without a path is an anchor not heard.

    Parameters
    ----------
    log : ResponseLog
        The responses.
    carrier_hz : float
        Carrier frequency, hertz; only recorded.
    config : ResponseConfig, optional
        How.

    Raises
    ------
    InputError
        If there are too few tones, or no path in any response.
    """
    config = config or ResponseConfig()
    offset_s = np.zeros(len(log.response))
    if log.tap_s is not None:
        taps = min(config.window_taps, log.response.shape[1])
        first = np.zeros(len(log.response), dtype=np.int64)
        if log.first_path_tap is not None and log.range_m is not None:
            first = np.floor(log.first_path_tap).astype(np.int64) - config.lead_taps
            offset_s = (first - log.first_path_tap) * log.tap_s + log.range_m / SPEED_OF_LIGHT_M_S
        else:
            taps = log.response.shape[1]
        cfr, spacing = tones_of_taps(log.response, log.tap_s, first, taps, log.bandwidth_hz, log.alone)
    else:
        cfr, spacing = log.response, float(log.tone_spacing_hz or 0.0)
        if log.alone is not None:
            cfr = cfr / (log.alone / np.sqrt(np.mean(np.abs(log.alone) ** 2)))
            if not np.isfinite(cfr).all():
                raise InputError("calibration: expected numbers that are not 0")
    plan = DiffusePlan(OfdmGrid(carrier_hz, spacing, cfr.shape[1]), config.diffuse)
    found = plan.estimate(cfr, log.noise_variance)
    most = 1 if config.first_only else None
    nothing = np.full(1, np.nan)

    def joined(columns: list[Array]) -> Array:
        return np.concatenate([column[:most] if column.size else nothing for column in columns])

    row = np.repeat(np.arange(len(found)), [max(len(e.delay_s[:most]), 1) for e in found])
    delay, variance = joined([e.delay_s for e in found]), joined([e.variance_s2 for e in found])
    gain = joined([np.abs(e.gain) for e in found])
    return RangeLog(
        log.time_s[row],
        log.anchor[row],
        SPEED_OF_LIGHT_M_S * (delay + offset_s[row]),
        log.names,
        range_std_m=SPEED_OF_LIGHT_M_S * np.sqrt(variance),
        gain_db=20.0 * np.log10(gain),
    )
