"""Configuration of the particle engine.

The models are the paper's (Section V-E). Four defaults of the inference are not: as
published it loses walls and agents (numbers beside :meth:`ParticleConfig.published`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from estimator.errors import ConfigurationError

__all__ = ["ParticleConfig"]

_MAY_BE_ZERO = (
    "clutter_mean",
    "acceleration_variance",
    "start_std_m",
    "feature_std_m",
    "anchor_std_m",
    "height2_mean_m2",
    "vanish_probability",
    "appear_probability",
)
_PROBABILITIES = (
    "detection_probability",
    "survival_probability",
    "prune_probability",
    "detect_threshold",
    "start_visibility",
    "appear_probability",
    "vanish_probability",
)
_ANYWHERE_M = 1e6


@dataclass(frozen=True)
class ParticleConfig:
    """Models and limits of the particle engine.

    Parameters
    ----------
    particles : int
        Particles of the agent and of each feature.
    range_std_m : float
        Smallest standard deviation believed of a path length, metres.
    detection_probability : float
        Probability that a visible feature is measured.
    clutter_mean : float
        Mean number of false alarms per anchor and epoch.
    region_m : float
        Radius of the region of interest: false alarms are uniform on (0, region),
        virtual anchors of new features uniform on the disc of that radius.
    gate_sigma : float
        Paths further than this from every particle's range are not compared with it.
    acceleration_variance : float
        Driving noise of the near-constant-velocity motion (39), m^2/s^4 per axis.
    velocity_std_m_s : float
        Standard deviation of the agent's unknown initial velocity, per axis.
    start_std_m : float
        Standard deviation of the agent's start, per axis; 0 where it defines RP.
    anchor_std_m : float
        Standard deviation of known anchors, per axis.
    feature_std_m : float
        Driving noise of features per epoch and axis, metres: keeps their beliefs from
        narrowing beyond what independent marginals can know.
    height2_mean_m2 : float
        Squared height difference of anchors and agent, square metres.
    survival_probability : float
        Probability that a feature that exists still exists an epoch later, (41).
    new_mean : float
        Mean number of new features per anchor and epoch.
    nearest_wall_m : float
        Smallest distance of a new wall's VRP from RP: closer, the wall would run through the agent's start.
    prune_probability : float
        Features less likely to exist than this are dropped.
    detect_threshold : float
        Existence probability from which a feature counts as found, (35).
    found_std_m : float
        Standard deviation per axis up to which a feature that exists counts as found, metres. A path alone
        puts a feature on a circle, whose middle is no place.
    similarity_m : float
        Features closer than this are one, (48), metres.
    worse_ratio : float
        A belief whose variance an anchor's paths would raise by more than this ratio is
        not updated, (48). At 1, as published, the rule ratchets: of beliefs that only
        fluctuate it keeps those that came out too narrow; by default
        it only refuses a belief that falls apart.
    start_visibility : float
        Probability that a feature can be heard by an anchor that has not told; 1 (with
        ``vanish_probability`` 0) is the constant detection probability of the paper.
    appear_probability, vanish_probability : float
        Per epoch, that an invisible feature becomes visible and the reverse.
    pairings : int
        Random pairings of the particles of agent, anchor and wall over which a message
        is averaged; 1 stacks each particle with one of each other node.
    start_matches : int
        Paths that must agree before an anchor is located.
    start_window : int
        Epochs searched when one was not enough.
    """

    particles: int = 100_000
    range_std_m: float = 0.05
    detection_probability: float = 0.95
    clutter_mean: float = 1.0
    region_m: float = 180.0
    gate_sigma: float = 5.0
    acceleration_variance: float = 0.0278
    velocity_std_m_s: float = 1.0
    start_std_m: float = 0.0
    anchor_std_m: float = 0.0
    feature_std_m: float = 0.01
    height2_mean_m2: float = 0.0
    survival_probability: float = 0.999
    new_mean: float = 1e-4
    nearest_wall_m: float = 0.5
    prune_probability: float = 1e-4
    detect_threshold: float = 0.5
    found_std_m: float = 5.0
    similarity_m: float = 1.0
    worse_ratio: float = 100.0
    start_visibility: float = 0.5
    appear_probability: float = 0.01
    vanish_probability: float = 0.01
    pairings: int = 4
    start_matches: int = 4
    start_window: int = 16

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            name = f"ParticleConfig.{entry.name}"
            if not np.isfinite(value) or value < 0.0 or (value == 0.0 and entry.name not in _MAY_BE_ZERO):
                raise ConfigurationError(f"{name}: expected a positive number, got {value!r}")
            if entry.name in _PROBABILITIES and value > 1.0:
                raise ConfigurationError(f"{name}: expected at most 1, got {value!r}")
            if entry.type == "int" and value != int(value):
                raise ConfigurationError(f"{name}: expected a whole number, got {value!r}")
        if self.detection_probability == 1.0:
            raise ConfigurationError("ParticleConfig.detection_probability: expected less than 1, got 1.0")

    def published(self) -> ParticleConfig:
        """The same models with the paper's inference to the letter.

        One pairing of particles, features that hardly move (variance 1e-8), one detection
        probability for all pairs of anchor and feature, updates refused as soon as the
        variance rises, and features found as soon as they exist, on whatever circle. In the
        paper's room (10,000 particles, 8 runs, hybrid) that loses a run and most walls; the
        defaults lose none.
        """
        return replace(
            self,
            pairings=1,
            feature_std_m=1e-4,
            start_visibility=1.0,
            appear_probability=0.0,
            vanish_probability=0.0,
            worse_ratio=1.0,
            found_std_m=_ANYWHERE_M,
        )

    @property
    def clutter_density(self) -> float:
        """Clutter intensity ``mu_false f_false``, per metre; at least one in a hundred epochs."""
        return max(self.clutter_mean, 0.01) / self.region_m
