"""The sweep of an epoch: the agent looked for elsewhere, flashes taken, hypotheses reduced."""

from __future__ import annotations

import numpy as np

from estimator.measurements import Epoch
from estimator.slam.gaussian.clutter import clutter_density
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.integrity import is_suspect
from estimator.slam.gaussian.phase import Phase
from estimator.slam.gaussian.relocation import relocated
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.gaussian.sweep_update import take_sweep
from estimator.slam.gaussian.turns import speed_penalty
from estimator.slam.mixture_reduction import reduce_mixture
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.hypotheses import log_sum_exp

__all__ = ["follow_sweep"]


def follow_sweep(
    state: GaussianState, epoch: Epoch, paths: EpochPaths, config: GaussianConfig, phase: Phase
) -> GaussianState:
    """Take the epoch's sweep; hypotheses that it refutes are dropped before paths are looked at.

    Parameters
    ----------
    state : GaussianState
        State with predicted hypotheses.
    epoch : Epoch
        Its sweep is taken.
    paths : EpochPaths
        Its paths; they only help to find the agent elsewhere.
    config : GaussianConfig
        Models.
    phase : Phase
        Of the run.

    Returns
    -------
    GaussianState
    """
    elsewhere = relocated(
        state,
        epoch.sweep,
        paths,
        clutter_density(state.buffer, state.layout.anchors, state.blind, config.noise, config.clutter),
        config.sweeps.new_flash_density,
        config.relocation,
        config.visibility,
        config.motion.speed_std_m_s,
        not is_suspect(state.indicators, config.integrity),
        epoch.odometry is not None,
    )
    here = state.hypotheses.number
    if elsewhere is not None:
        state = state.but(hypotheses=state.hypotheses.joined(elsewhere))
    state, parent = take_sweep(
        state,
        epoch.sweep,
        epoch.heading_held,
        config.sweeps,
        config.corrections.most_turn_rad,
        config.visibility,
    )
    swept = state.hypotheses
    swept = swept._replace(log_weight=swept.log_weight + speed_penalty(swept, config.motion))
    tracked, found = swept.take(np.flatnonzero(parent < here)), swept.take(np.flatnonzero(parent >= here))
    share = log_sum_exp(tracked.log_weight)
    kept = reduce_mixture(tracked, config.reduce_model(phase, state.layout))
    kept = kept._replace(log_weight=kept.log_weight + share)  # paths judge those found elsewhere first
    return state.but(hypotheses=kept.joined(found))
