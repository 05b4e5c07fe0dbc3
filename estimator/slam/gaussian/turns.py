"""Sudden turns: a branch of the motion model, where something can tell it from going on."""

from __future__ import annotations

import numpy as np

from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.motion import Motion
from estimator.slam.models.state_vector import AGENT

__all__ = ["with_turns"]


def with_turns(hypotheses: Hypotheses, step_s: float, motion: Motion) -> Hypotheses:
    """The hypotheses, and each of them once more with a new velocity from now on.

    Parameters
    ----------
    hypotheses : Hypotheses
        Before the prediction.
    step_s : float
        Time until the next epoch, seconds.
    motion : Motion
        ``turn_rate_hz`` and ``velocity_std_m_s``.
    """
    chance = min(0.5, motion.turn_rate_hz * step_s)
    if chance <= 0.0:
        return hypotheses
    turned = hypotheses.take(np.arange(hypotheses.number))
    speed = slice(2, AGENT.stop)
    turned.mean[:, speed] = 0.0
    turned.covariance[:, speed, :] = 0.0
    turned.covariance[:, :, speed] = 0.0
    turned.covariance[:, speed, speed] = motion.velocity_std_m_s**2 * np.eye(2)
    turned.log_weight[...] += np.log(chance)
    straight = hypotheses._replace(log_weight=hypotheses.log_weight + np.log1p(-chance))
    return straight.joined(turned)
