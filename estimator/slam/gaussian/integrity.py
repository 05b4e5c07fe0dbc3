"""Integrity: whether map and pose are right, judged by evidence and not by the covariance alone.

What a lost run shows: paths of located anchors that nothing explains, or that fit badly, a pose that is
hardly known, and no sweep or odometry lately that told how the agent moves. Running means of these give the
probability that the agent is more than a metre from where it is thought to be: a logistic regression, fitted
on runs of other buildings, with few sweeps and many, that were lost and were not. The protection level bounds
the error with a stated risk, the chance of being wrong included.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.settings import Settings, any_number, positive, probability, share
from estimator.slam.protocol import Integrity

__all__ = [
    "Indicators",
    "IntegrityModel",
    "is_doubtful",
    "is_lost",
    "is_suspect",
    "judged",
    "no_indicators",
    "possible_evidence",
    "with_epoch",
]

Array = NDArray[np.float64]
_LEAST_STD_M = 1e-3  # numerical floor
_LEAST_DOUBT = 1e-6  # rounding, in log odds: just doubtful


@dataclass(frozen=True)
class IntegrityModel(Settings):
    """How signs become a probability, and the probability a state.

    Parameters
    ----------
    memory_epochs : float
        Epochs over which paths are averaged,
    smoothing_epochs : float
        and the log odds after that.
    usual_paths, usual_unexplained, usual_shortfall : float
        Few paths tell little: so many more are counted, of which this share is unexplained, and this
        shortfall each.
    untold_epochs : int
        Where neither sweep nor odometry told how the agent moves for more epochs than this, nothing else
        than paths did.
    settled_epochs : int
        A run that has been beyond suspicion in so many epochs has a map worth keeping as it was, once it is
        lost.
    odds_offset, odds_unexplained, odds_shortfall, odds_std, odds_untold : float
        Log odds of being more than a metre off: at a standard deviation of 1 m; more for each unit of the
        share of unexplained paths, of the shortfall of a path, and of the log of the
        standard deviation in metres; and where only paths tell. Logistic regression on 104 runs in 32
        buildings, with a sweep at every epoch, at every second, at every tenth beside odometry, and at the
        start alone.
    doubtful_probability, lost_probability : float
        Probability of being wrong from which a run is doubtful, and lost.
    suspect_share : float
        Where more than this share of an epoch's paths is unexplained, the next sweep is held against the
        whole map.
    jump_sigma : float
        An agent that is now farther from where it was than its speed allows, beyond so many standard
        deviations of both places, was wrong then or is wrong now: it counts as lost.
    model_std_m : float
        Standard deviation of what the models leave out, in the protection level, metres.
    wrong_beyond_m : float
        A run is wrong where it is farther off than this, metres: so far as a covariance alone says it is,
        too.
    wrong_std_m : float
        How far off, per axis, a run that is wrong may be, metres.
    risk : float
        Probability that the error exceeds the protection level.
    """

    memory_epochs: float = positive(6.0)
    smoothing_epochs: float = positive(3.0)
    usual_paths: float = positive(5.0)
    usual_unexplained: float = share(0.25)
    usual_shortfall: float = any_number(3.0)
    untold_epochs: int = positive(12)
    settled_epochs: int = positive(12)
    odds_offset: float = any_number(-1.88)
    odds_unexplained: float = any_number(5.52)
    odds_shortfall: float = any_number(0.22)
    odds_std: float = any_number(1.61)
    odds_untold: float = any_number(2.51)
    doubtful_probability: float = probability(0.3)
    lost_probability: float = probability(0.8)
    suspect_share: float = share(0.5)
    jump_sigma: float = positive(3.0)
    model_std_m: float = positive(0.05)
    wrong_beyond_m: float = positive(1.0)
    wrong_std_m: float = positive(5.0)
    risk: float = probability(0.001)


class Indicators(NamedTuple):
    """Signs of whether the run is right, older ones decayed.

    Parameters
    ----------
    paths, unexplained, shortfall : float
        Paths of located anchors, those of them that nothing explains, and by how much the log evidence of all
        is less than that of paths whose lengths and labels were known beforehand.
    log_odds : float
        Of being wrong, smoothed.
    jump_m : float
        How far the agent jumped when it last did, metres; 0 once nothing is doubtful.
    latest : float
        Share of unexplained paths at the latest epoch that had any of located anchors.
    untold : float
        Epochs since a sweep or odometry told how the agent moves.
    astray : float
        1 where the run was lost and nothing but paths has told of it since, else 0.
    suspected : float
        Epochs in a row after which the run was suspect.
    settled : float
        Epochs after which it was neither suspect nor astray.
    """

    paths: float
    unexplained: float
    shortfall: float
    log_odds: float
    jump_m: float
    latest: float
    untold: float
    astray: float
    suspected: float
    settled: float


def possible_evidence(paths: EpochPaths, located: NDArray[np.bool_], clutter: Array) -> float:
    """Log evidence of the paths of located anchors, over clutter, were all explained and known beforehand."""
    valid = paths.valid & located[:, None]
    ratio = math.sqrt(2.0 * math.pi * math.e) * paths.std_m * clutter[:, None]
    return float(-np.log(ratio[valid]).sum())


def no_indicators(model: IntegrityModel) -> Indicators:
    """Those of a run that has not begun: it stands where it starts."""
    usual = model.odds_unexplained * model.usual_unexplained + model.odds_shortfall * model.usual_shortfall
    odds = model.odds_offset + usual + model.odds_std * float(np.log(model.model_std_m))
    return Indicators(0.0, 0.0, 0.0, odds, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def with_epoch(
    now: Indicators,
    paths: float,
    unexplained: float,
    shortfall: float,
    std_m: float,
    jump_m: float,
    untold: int,
    model: IntegrityModel,
    regained: bool = False,
) -> Indicators:
    """The indicators after an epoch.

    Parameters
    ----------
    now : Indicators
        Those before it.
    paths, unexplained, shortfall : float
        As in :class:`Indicators`, of the epoch alone.
    std_m : float
        Standard deviation of the position, both axes together, metres.
    jump_m : float
        How far the agent moved, metres, where it is farther than it can; otherwise 0.
    untold : int
        Epochs since a sweep or odometry told how the agent moves.
    model : IntegrityModel
        Weights.
    regained : bool
        Whether the paths single out, of all places of the map, the one where the agent is thought to be.
    """
    keep = 1.0 - 1.0 / model.memory_epochs
    heard = keep * now.paths + paths
    lacking = keep * now.unexplained + unexplained
    short = keep * now.shortfall + shortfall
    counted = heard + model.usual_paths
    lack = (lacking + model.usual_paths * model.usual_unexplained) / counted
    each = (short + model.usual_paths * model.usual_shortfall) / counted
    odds = model.odds_offset + model.odds_std * float(np.log(max(std_m, _LEAST_STD_M)))
    odds += model.odds_unexplained * lack + model.odds_shortfall * each
    if untold > model.untold_epochs:
        odds += model.odds_untold
    alone = float(np.exp(-((model.wrong_beyond_m / max(std_m, _LEAST_STD_M)) ** 2)))
    odds = max(odds, _log_odds(max(alone, model.risk)))
    weight = 1.0 / model.smoothing_epochs
    odds = (1.0 - weight) * now.log_odds + weight * odds
    if jump_m > 0.0:
        odds = max(odds, _log_odds(model.lost_probability) + 1.0)
    alone_told = untold > model.untold_epochs
    astray = float(
        alone_told
        and not (regained and now.settled >= model.settled_epochs)
        and (now.astray > 0.0 or odds > _log_odds(model.lost_probability))
    )
    if astray:  # few paths fit many places
        odds = max(odds, _log_odds(model.doubtful_probability) + _LEAST_DOUBT)
    latest = unexplained / paths if paths >= 1.0 else now.latest
    jumped = jump_m or now.jump_m
    after = Indicators(heard, lacking, short, odds, jumped, latest, float(untold), astray, 0.0, now.settled)
    if is_suspect(after, model):
        after = after._replace(suspected=now.suspected + 1.0)
    else:
        after = after._replace(settled=now.settled + 1.0)
    return after if is_doubtful(after, model) else after._replace(jump_m=0.0)


def is_doubtful(now: Indicators, model: IntegrityModel) -> bool:
    """Whether a run is doubtful or lost."""
    return now.log_odds > _log_odds(model.doubtful_probability)


def is_lost(now: Indicators, model: IntegrityModel) -> bool:
    """Whether a run with a map worth keeping is lost, or was and nothing has told since where it is."""
    lost = now.astray > 0.0 or now.log_odds > _log_odds(model.lost_probability)
    return lost and now.settled >= model.settled_epochs


def is_suspect(now: Indicators, model: IntegrityModel) -> bool:
    """Whether a run is doubtful, or its latest paths speak against it."""
    return is_doubtful(now, model) or now.latest > model.suspect_share


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


def judged(now: Indicators, covariance_m2: Array, model: IntegrityModel) -> Integrity:
    """What the indicators say of an estimate whose position has the given covariance (2, 2).

    Its reasons name the signs that speak against it.
    """
    wrong = 1.0 / (1.0 + float(np.exp(-now.log_odds)))
    variance = float(np.linalg.eigvalsh(covariance_m2)[-1])
    level = float(np.sqrt((variance + model.model_std_m**2) * -2.0 * np.log(model.risk)))
    if wrong > model.risk:
        level = max(level, model.wrong_std_m * float(np.sqrt(2.0 * np.log(wrong / model.risk))))
    state = "ok"
    if wrong > model.doubtful_probability:
        state = "lost" if wrong > model.lost_probability else "doubtful"
    reasons = []
    if state != "ok":
        lacking, short = (value / max(now.paths, 1.0) for value in (now.unexplained, now.shortfall))
        if lacking > 2.0 * model.usual_unexplained:
            reasons.append(f"{100.0 * lacking:.0f} % of the paths are unexplained")
        elif short > 2.0 * model.usual_shortfall:
            reasons.append("the paths fit badly")
        std = float(np.sqrt(np.trace(covariance_m2)))
        if std > 5.0 * model.model_std_m:
            reasons.append(f"the position is known to {std:.2g} m only")
        if now.jump_m > 0.0:
            reasons.append(f"the position jumped by {now.jump_m:.2g} m")
        if now.untold > model.untold_epochs:
            reasons.append("neither sweep nor odometry tells the way")
        if now.astray > 0.0:
            reasons.append("it was lost, and only paths have told since")
    return Integrity(state, 1.0 - wrong, level, tuple(reasons))
