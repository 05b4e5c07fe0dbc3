"""The two halves of an epoch: prediction, and what one anchor's paths change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import AnchorPaths
from estimator.slam.methods import Method
from estimator.slam.models.motion import process_noise, transition
from estimator.slam.particle.births import born_features, new_odds
from estimator.slam.particle.cloud import Cloud, moved, normals, resample, total_variance
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.messages import Nodes, exchange
from estimator.slam.particle.state import ParticleState

__all__ = ["hear_anchor", "predict"]


def predict(
    state: ParticleState,
    step_s: float,
    asked: NDArray[np.bool_],
    method: Method,
    config: ParticleConfig,
    rng: np.random.Generator,
) -> ParticleState:
    """Beliefs one step later: the agent by (38), (39), the features by (40), (41).

    Parameters
    ----------
    state : ParticleState
        State after the epoch before.
    step_s : float
        Time since, seconds.
    asked : ndarray of bool, shape (K,)
        Anchors that are asked: what the others would be heard over neither appears nor vanishes.
    method : Method
        Whether anchors are known: the others are features too, and as such move a little.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of the driving noise.
    """
    noise = process_noise(step_s, config.motion.acceleration_variance)
    agent = moved(state.agent, transition(step_s), noise, rng)
    # one table of driving noise, of which every coordinate of every feature reads from a place of its own
    driving = np.float32(config.motion.feature_std_m) * normals(state.particles, rng)

    def driven(clouds: tuple[Cloud, ...]) -> tuple[Cloud, ...]:
        places = rng.integers(state.particles, size=(len(clouds), 2)).tolist()
        return tuple(_driven(cloud, driving, place) for cloud, place in zip(clouds, places, strict=True))

    before = state.features
    stay, appear = 1.0 - config.visibility.vanish_probability, config.visibility.appear_probability
    features = replace(
        before,
        points_m=driven(before.points_m),
        existence=config.features.survival_probability * before.existence,
        visibility=np.where(
            asked, stay * before.visibility + appear * (1.0 - before.visibility), before.visibility
        ),
    )
    anchors = state.anchors_m if method.anchors == "known" else driven(state.anchors_m)
    sight = np.where(asked, stay * state.sight + appear * (1.0 - state.sight), state.sight)
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
    length, std = paths.range_m, np.maximum(paths.range_std_m, config.noise.range_std_m)
    features = state.features
    mine = np.flatnonzero((features.owner < 0) | (features.owner == k))
    nodes = Nodes(
        agent=state.agent[:2],
        anchor=state.anchors_m[k],
        points=tuple(features.points_m[j] for j in mine.tolist()),
        shared=method.shared,
        existence=np.concatenate([[1.0], features.existence[mine]]),
        visibility=np.concatenate([[state.sight[k]], features.visibility[mine, k]]),
        fixed=method.anchors == "known",
    )
    said = exchange(nodes, length, std, new_odds(length, config), config, rng)
    agent = resample(state.agent, said.agent, rng)
    anchors, points = list(state.anchors_m), list(features.points_m)
    if not nodes.fixed:
        anchors[k] = _refined(anchors[k], said.anchor, config, rng)
    for j, log_weight in zip(mine.tolist(), said.points, strict=True):
        if log_weight is not None:
            points[j] = _refined(points[j], log_weight, config, rng)
    existence, seen, sight = features.existence.copy(), features.visibility.copy(), state.sight.copy()
    existence[mine], seen[mine, k], sight[k] = said.existence[1:], said.visibility[1:], said.visibility[0]
    features = replace(features, points_m=tuple(points), existence=existence, visibility=seen)
    visibility = np.full(len(state.anchor_names), config.visibility.start_visibility)
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
        anchors_m=tuple(anchors),
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
    worse = total_variance(after)[1] > config.inference.worse_ratio * total_variance(cloud)[1]
    return cloud if worse else after


def _driven(cloud: Cloud, driving: NDArray[np.float32], places: list[int]) -> Cloud:
    """A cloud (2, N) plus noise (N,), read cyclically by each coordinate from its place on."""
    out, rest = np.empty_like(cloud), len(driving) - np.array(places)
    for axis, (place, left) in enumerate(zip(places, rest.tolist(), strict=True)):
        np.add(cloud[axis, :left], driving[place:], out=out[axis, :left])
        np.add(cloud[axis, left:], driving[:place], out=out[axis, left:])
    return out
