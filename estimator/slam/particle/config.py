"""Configuration of the particle engine, in groups.

The models are the paper's (Section V-E). Four defaults of the inference are not: as
published it loses walls and agents (numbers beside :meth:`ParticleConfig.published`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.settings import (
    SettingGroups,
    Settings,
    not_negative,
    positive,
    probability,
    share,
    up_to_one,
)

__all__ = [
    "AnchorStart",
    "FeatureLife",
    "Inference",
    "ParticleConfig",
    "ParticleMotion",
    "ParticleVisibility",
]

_ANYWHERE_M = 1e6


@dataclass(frozen=True)
class Inference(Settings):
    """How beliefs are computed.

    Parameters
    ----------
    particles : int
        Particles of the agent and of each feature.
    pairings : int
        Random pairings of the particles of agent, anchor and wall over which a message
        is averaged; 1 stacks each particle with one of each other node.
    gate_sigma : float
        Paths further than this from every particle's range are not compared with it.
    worse_ratio : float
        A belief whose variance an anchor's paths would raise by more than this ratio is
        not updated, (48). At 1, as published, the rule ratchets: of beliefs that only
        fluctuate it keeps those that came out too narrow; by default
        it only refuses a belief that falls apart.
    """

    particles: int = positive(100_000)
    pairings: int = positive(4)
    gate_sigma: float = positive(5.0)
    worse_ratio: float = positive(100.0)


@dataclass(frozen=True)
class ParticleMotion(Settings):
    """How the nodes move, and where they start.

    Parameters
    ----------
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
    """

    acceleration_variance: float = not_negative(0.0278)
    velocity_std_m_s: float = positive(1.0)
    start_std_m: float = not_negative(0.0)
    anchor_std_m: float = not_negative(0.0)
    feature_std_m: float = not_negative(0.01)


@dataclass(frozen=True)
class ParticleVisibility(Settings):
    """How features appear and vanish.

    Parameters
    ----------
    start_visibility : float
        Probability that a feature can be heard by an anchor that has not told; 1 (with
        ``vanish_probability`` 0) is the constant detection probability of the paper.
    appear_probability, vanish_probability : float
        Per epoch, that an invisible feature becomes visible and the reverse.
    """

    start_visibility: float = up_to_one(0.5)
    appear_probability: float = share(0.01)
    vanish_probability: float = share(0.01)


@dataclass(frozen=True)
class FeatureLife(Settings):
    """When features start, count as found, are one, and end.

    Parameters
    ----------
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
    """

    survival_probability: float = up_to_one(0.999)
    new_mean: float = positive(1e-4)
    nearest_wall_m: float = positive(0.5)
    prune_probability: float = probability(1e-4)
    detect_threshold: float = up_to_one(0.5)
    found_std_m: float = positive(5.0)
    similarity_m: float = positive(1.0)


@dataclass(frozen=True)
class AnchorStart(Settings):
    """When anchors are located.

    Parameters
    ----------
    start_matches : int
        Paths that must agree before an anchor is located.
    start_window : int
        Epochs searched when one was not enough.
    """

    start_matches: int = positive(4)
    start_window: int = positive(16)


def _planar_noise() -> MeasurementNoise:
    """The paper's: a plane, and one false alarm."""
    return MeasurementNoise(range_std_m=0.05, clutter_mean=1.0, height2_mean_m2=0.0)


@dataclass(frozen=True)
class ParticleConfig(SettingGroups):
    """Models and limits of the particle engine, in groups.

    Parameters
    ----------
    inference : Inference
        Particles and messages.
    noise : MeasurementNoise
        Noise of path lengths, misses, clutter and heights; of gains nothing is used. False alarms are uniform
        on (0, ``region_m``), virtual anchors of new features on the disc of that radius.
    motion : ParticleMotion
        How the nodes move.
    visibility : ParticleVisibility
        How features appear and vanish.
    features : FeatureLife
        When features start and end.
    anchors : AnchorStart
        When anchors are located.
    """

    inference: Inference = field(default_factory=Inference)
    noise: MeasurementNoise = field(default_factory=_planar_noise)
    motion: ParticleMotion = field(default_factory=ParticleMotion)
    visibility: ParticleVisibility = field(default_factory=ParticleVisibility)
    features: FeatureLife = field(default_factory=FeatureLife)
    anchors: AnchorStart = field(default_factory=AnchorStart)

    def published(self) -> ParticleConfig:
        """The same models with the paper's inference to the letter.

        One pairing of particles, features that hardly move (variance 1e-8), one detection
        probability for all pairs of anchor and feature, updates refused as soon as the
        variance rises, and features found as soon as they exist, on whatever circle. In the
        paper's room (10,000 particles, 8 runs, hybrid) that loses a run and most walls; the
        defaults lose none.
        """
        return self.but(
            pairings=1,
            feature_std_m=1e-4,
            start_visibility=1.0,
            appear_probability=0.0,
            vanish_probability=0.0,
            worse_ratio=1.0,
            found_std_m=_ANYWHERE_M,
        )
