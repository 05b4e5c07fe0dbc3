"""The two halves of an epoch: prediction, and what one anchor's paths change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import AnchorPaths
from estimator.slam.methods import Method
from estimator.slam.motion import process_noise, transition
from estimator.slam.particle.births import born_features, new_odds
from estimator.slam.particle.cloud import Cloud, gaussian_cloud, moments_of, resample
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.messages import Nodes, exchange
from estimator.slam.particle.state import ParticleState

__all__ = ["hear_anchor", "predict"]


def predict(
    state: ParticleState, step_s: float, method: Method, config: ParticleConfig, rng: np.random.Generator
) -> ParticleState:
    """Beliefs one step later: the agent by (38), (39), the features by (40), (41).

    Parameters
    ----------
    state : ParticleState
        State after the epoch before.
    step_s : float
        Time since, seconds.
    method : Method
        Whether anchors are known: the others are features too, and as such move a little.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of the driving noise.
    """
    noise = process_noise(step_s, config.acceleration_variance)
    agent = transition(step_s).astype(np.float32) @ state.agent
    agent += gaussian_cloud(np.zeros(4), noise, state.particles, rng)
    features = state.features.copy()
    # one table of driving noise, which every feature reads from a place of its own
    driving = gaussian_cloud(np.zeros(2), config.feature_std_m**2 * np.eye(2), state.particles, rng)
    anchors = state.anchors_m.copy()
    static = [*features.points_m, *(() if method.anchors == "known" else anchors)]
    for cloud, shift in zip(static, rng.integers(state.particles, size=len(static)), strict=True):
        cloud += np.roll(driving, shift, axis=-1)
    features.existence[...] *= config.survival_probability
    stay, appear = 1.0 - config.vanish_probability, config.appear_probability
    features.visibility[...] = stay * features.visibility + appear * (1.0 - features.visibility)
    sight = stay * state.sight + appear * (1.0 - state.sight)
    return replace(state, agent=agent, anchors_m=anchors, features=features, sight=sight)


def hear_anchor(
    state: ParticleState,
    k: int,
    paths: AnchorPaths,
    method: Method,
    config: ParticleConfig,
    rng: np.random.Generator,
) -> ParticleState:
    """The state after the paths of anchor ``k``, which has been located.

    Parameters
    ----------
    state : ParticleState
        Predicted state, or the state after the anchor before.
    k : int
        The anchor.
    paths : AnchorPaths
        Its paths.
    method : Method
        Whether the anchor is known, and whether features are shared.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of randomness.
    """
    length, std = paths.range_m, np.maximum(paths.range_std_m, config.range_std_m)
    features = state.features.copy()
    mine = np.flatnonzero((features.owner < 0) | (features.owner == k))
    nodes = Nodes(
        agent=state.agent[:2],
        anchor=state.anchors_m[k],
        points=features.points_m[mine],
        shared=method.shared,
        existence=np.concatenate([[1.0], features.existence[mine]]),
        visibility=np.concatenate([[state.sight[k]], features.visibility[mine, k]]),
    )
    said = exchange(nodes, length, std, new_odds(length, config), config, rng)
    agent = resample(state.agent, said.agent, rng)
    anchors = state.anchors_m.copy()
    if method.anchors != "known":
        anchors[k] = _refined(anchors[k], said.anchor, config, rng)
    for j, log_weight in zip(mine.tolist(), said.points, strict=True):
        features.points_m[j] = _refined(features.points_m[j], log_weight, config, rng)
    features.existence[mine] = said.existence[1:]
    features.visibility[mine, k] = said.visibility[1:]
    sight = state.sight.copy()
    sight[k] = said.visibility[0]
    visibility = np.full(len(state.anchor_names), config.start_visibility)
    visibility[k] = 1.0
    new = born_features(
        agent[:2],
        anchors[k],
        -1 if method.shared else k,
        (length, std),
        said.unexplained,
        visibility,
        (state.next_wall_id, state.epoch),
        config,
        rng,
    )
    return replace(
        state,
        agent=agent,
        anchors_m=anchors,
        sight=sight,
        features=features.joined(new),
        next_wall_id=state.next_wall_id + len(new),
        log_evidence=state.log_evidence + said.log_evidence,
    )


def _refined(
    cloud: Cloud, log_weight: NDArray[np.float32], config: ParticleConfig, rng: np.random.Generator
) -> Cloud:
    """The belief with its weights taken in, unless that made it less certain, (48)."""
    if log_weight.max() == log_weight.min():
        return cloud
    after = resample(cloud, log_weight, rng)
    worse = np.trace(moments_of(after)[1]) > config.worse_ratio * np.trace(moments_of(cloud)[1])
    return cloud if worse else after
