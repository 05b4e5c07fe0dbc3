"""Sudden turns, a branch of the motion model where something can tell it from going on; largest speeds.

Beside what the paths of an epoch without a sweep say stands what would be, were they all mislabelled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.hypotheses import Hypotheses, log_sum_exp
from estimator.slam.models.motion import Motion
from estimator.slam.models.state_vector import AGENT

__all__ = ["speed_penalty", "with_doubt", "with_turns"]


def with_turns(hypotheses: Hypotheses, step_s: float, motion: Motion) -> Hypotheses:
    """The hypotheses, and each of them once more with a new velocity from now on.

    Parameters
    ----------
    hypotheses : Hypotheses
        Before the prediction.
    step_s : float
        Time until the next epoch, seconds.
    motion : Motion
        ``turn_rate_hz``, and ``velocity_std_m_s`` or half the largest speed.
    """
    chance = min(0.5, motion.turn_rate_hz * step_s)
    if chance <= 0.0:
        return hypotheses
    turned = hypotheses.take(np.arange(hypotheses.number))
    speed = slice(2, AGENT.stop)
    turned.mean[:, speed] = 0.0
    turned.covariance[:, speed, :] = 0.0
    turned.covariance[:, :, speed] = 0.0
    turned.covariance[:, speed, speed] = motion.speed_std_m_s**2 * np.eye(2)
    turned.log_weight[...] += np.log(chance)
    straight = hypotheses._replace(log_weight=hypotheses.log_weight + np.log1p(-chance))
    return straight.joined(turned)


def speed_penalty(hypotheses: Hypotheses, motion: Motion) -> NDArray[np.float64]:
    """Log weight (R,) that hypotheses lose whose agent is faster than it can be; zero without a bound."""
    if motion.max_speed_m_s <= 0.0:
        return np.zeros(hypotheses.number)
    speed = np.hypot(hypotheses.mean[:, 2], hypotheses.mean[:, 3])
    variance = 0.5 * (hypotheses.covariance[:, 2, 2] + hypotheses.covariance[:, 3, 3])
    slack = (motion.speed_slack * motion.max_speed_m_s) ** 2 + variance
    return np.asarray(-0.5 * np.maximum(speed - motion.max_speed_m_s, 0.0) ** 2 / slack)


def with_doubt(updated: Hypotheses, predicted: Hypotheses, doubt: float) -> Hypotheses:
    """The hypotheses, and beside them those without the paths: between sweeps all labels may be wrong.

    The next sweep decides between them.
    """
    unlabelled = predicted._replace(
        log_weight=predicted.log_weight - log_sum_exp(predicted.log_weight) + np.log(doubt)
    )
    labelled = updated._replace(
        log_weight=updated.log_weight - log_sum_exp(updated.log_weight) + np.log1p(-doubt)
    )
    return labelled.joined(unlabelled)
