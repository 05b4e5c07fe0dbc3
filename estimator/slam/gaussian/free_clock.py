"""A clock bias that is new in every epoch (TDOA, RSTD): what the engine does about it, epoch by epoch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.gaussian.clock_guesses import with_clock_guesses
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.hypotheses import Hypotheses

__all__ = ["guess_clock", "on_present_clock", "to_remember"]


def guess_clock(
    state: GaussianState, paths: EpochPaths, clutter: NDArray[np.float64], config: GaussianConfig
) -> Hypotheses:
    """The hypotheses with guesses of the epoch's bias, if it is free: :func:`with_clock_guesses`."""
    if config.clocks.clock_free_std_m == 0.0:
        return state.hypotheses
    return with_clock_guesses(
        state.layout,
        state.hypotheses,
        state.slots.confirmed,
        state.slots.owner,
        paths,
        clutter,
        config.noise.detection_probability,
        config.clock_guesses,
    )


def on_present_clock(state: GaussianState, earlier: Hypotheses, config: GaussianConfig) -> GaussianState:
    """The buffer's paths as long as the present bias would have made them, not that of the epoch before."""
    if config.clocks.clock_free_std_m == 0.0:
        return state
    now, bias = state.hypotheses, [state.layout.bias(k) for k in range(state.layout.anchors)]
    moved = now.mean[now.best, bias] - earlier.mean[earlier.best, bias]
    return state.but(buffer=state.buffer.shifted(moved))


def to_remember(state: GaussianState, paths: EpochPaths, config: GaussianConfig) -> EpochPaths:
    """The paths to be kept: none of an epoch in which no anchor tells its free bias."""
    if config.clocks.clock_free_std_m == 0.0 or state.hypotheses.located[state.hypotheses.best].any():
        return paths
    return paths._replace(number=np.zeros_like(paths.number))
