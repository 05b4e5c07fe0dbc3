"""The hypotheses at the next epoch: the agent moves on, clocks drift, features appear and vanish.

Where an epoch brings odometry, it takes the place of the motion model, sudden turns included. Time and
memory are linear in hypotheses and in the state vector.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.measurements import Epoch
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.turns import with_turns
from estimator.slam.models.clocks import ClockModel, predict_clocks
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.motion import Driving, predict_by_odometry, predict_motion
from estimator.slam.models.state_vector import HEADING, Layout

__all__ = ["Fading", "move_by_odometry", "move_on", "predict"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Fading(NamedTuple):
    """What becomes of clocks and features in a step.

    Parameters
    ----------
    step_s : float
        Time since the epoch before, seconds.
    clocks : ClockModel
        How clocks drift.
    appear, vanish : float
        Probabilities that a feature appears or vanishes.
    asked : ndarray of bool, shape (K,)
        Anchors whose features may: those that are asked.
    """

    step_s: float
    clocks: ClockModel
    appear: float
    vanish: float
    asked: Mask


def predict(
    layout: Layout,
    hypotheses: Hypotheses,
    epoch: Epoch,
    step_s: float,
    may_turn: bool,
    config: GaussianConfig,
) -> Hypotheses:
    """The hypotheses at an epoch, before its measurements.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    hypotheses : Hypotheses
        At the epoch before.
    epoch : Epoch
        The epoch; of it only odometry and what was asked are looked at.
    step_s : float
        Time since the epoch before, seconds.
    may_turn : bool
        Whether something will tell a sudden turn from going on.
    config : GaussianConfig
        Models.
    """
    motion, visibility = config.motion, config.visibility
    fading = Fading(
        step_s,
        config.clocks.model,
        visibility.appear_probability,
        visibility.vanish_probability,
        epoch.was_asked,
    )
    told = epoch.odometry
    if told is not None:
        return move_by_odometry(
            layout, hypotheses, told.displacement_m, told.turn_rad, told.covariance, fading
        )
    if may_turn:
        hypotheses = with_turns(hypotheses, step_s, motion)
    turned = motion.body_turn_std_rad**2 * step_s
    return move_on(layout, hypotheses, motion.driving(step_s), turned, fading)


@compiled
def move_on(
    layout: Layout, hypotheses: Hypotheses, driving: Driving, turn_variance: float, fading: Fading
) -> Hypotheses:
    """The agent goes on, its body turns with a variance (square radians) of which nobody told."""
    mean, covariance = hypotheses.mean.copy(), hypotheses.covariance.copy()
    for r in range(mean.shape[0]):
        predict_motion(mean[r], covariance[r], driving)
        covariance[r, HEADING, HEADING] += turn_variance
    return _faded(layout, hypotheses, mean, covariance, fading)


@compiled
def move_by_odometry(
    layout: Layout,
    hypotheses: Hypotheses,
    displacement_m: Array,
    turn_rad: float,
    spread: Array,
    fading: Fading,
) -> Hypotheses:
    """The agent moves as odometry says (:func:`estimator.slam.models.motion.predict_by_odometry`)."""
    mean, covariance = hypotheses.mean.copy(), hypotheses.covariance.copy()
    for r in range(mean.shape[0]):
        predict_by_odometry(mean[r], covariance[r], fading.step_s, displacement_m, turn_rad, spread)
    return _faded(layout, hypotheses, mean, covariance, fading)


@compiled
def _faded(
    layout: Layout, hypotheses: Hypotheses, mean: Array, covariance: Array, fading: Fading
) -> Hypotheses:
    visibility, asked = hypotheses.visibility.copy(), fading.asked
    for r in range(mean.shape[0]):
        predict_clocks(layout, mean[r], covariance[r], fading.step_s, fading.clocks)
        for k in range(asked.size):
            if asked[k]:
                for f in range(visibility.shape[2]):
                    seen = visibility[r, k, f]
                    visibility[r, k, f] = (1.0 - fading.vanish) * seen + fading.appear * (1.0 - seen)
    return Hypotheses(
        hypotheses.log_weight,
        mean,
        covariance,
        hypotheses.located,
        hypotheses.present,
        visibility,
        hypotheses.support,
    )
