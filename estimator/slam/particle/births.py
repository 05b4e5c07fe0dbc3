"""New features, what is one feature and what is none any more ((3), (46), (48))."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.particle.cloud import Cloud, moments_of, systematic
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.state import Features

__all__ = ["born_features", "merged", "new_odds", "pruned", "vrp_between"]

Array = NDArray[np.float64]
_NEAREST_M = 0.5  # VRPs closer to RP than this would be walls on top of the agent


def new_odds(length_m: Array, config: ParticleConfig) -> Array:
    """Odds that a path is of a new feature rather than clutter, (46) integrated over it.

    With virtual anchors uniform on the region's disc (radius ``R``) a length ``z`` has the
    density ``2 z / R^2``; clutter has ``1 / R``.

    Parameters
    ----------
    length_m : ndarray, shape (M,)
        Path lengths.
    config : ParticleConfig
        Models.
    """
    return np.asarray(config.new_mean * 2.0 * length_m / config.region_m**2 / config.clutter_density)


def vrp_between(anchor: Cloud, virtual: Cloud) -> Cloud:
    """VRPs (..., 2, N) of the walls half-way between anchors and virtual anchors, (3), RP at 0."""
    normal = virtual - anchor
    square = normal[..., 0, :] ** 2 + normal[..., 1, :] ** 2
    rise = np.sum(virtual * virtual, axis=-2) - np.sum(anchor * anchor, axis=-2)
    return np.asarray((rise / np.maximum(square, np.float32(1e-6)))[..., None, :] * normal)


def born_features(
    agent: Cloud,
    anchor: Cloud,
    owner: int,
    paths: tuple[Array, Array],
    unexplained: Array,
    visibility: Array,
    ids: tuple[int, int],
    config: ParticleConfig,
    rng: np.random.Generator,
) -> Features:
    """A feature for every path that no legacy feature explains.

    The virtual anchor lies on the circle round the agent, on any bearing; a wall is
    half-way to it, (3).

    Parameters
    ----------
    agent, anchor : ndarray of float32, shape (2, N)
        Positions.
    owner : int
        The anchor's number if features are virtual anchors, -1 if they are walls.
    paths : tuple of ndarray, shape (M,)
        Path lengths and their standard deviations.
    unexplained : ndarray, shape (M,)
        Probability that no legacy feature gave the path; less than ``detect_threshold``
        starts nothing.
    visibility : ndarray, shape (K,)
        Visibility of a feature just found, by anchor.
    ids : tuple of int
        The next identity, and the epoch.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Features
    """
    chosen = np.flatnonzero(unexplained > config.detect_threshold)
    length, std = (values[chosen, None].astype(np.float32) for values in paths)
    odds = new_odds(paths[0][chosen], config)
    shape = (len(chosen), agent.shape[1])
    radius = length + std * rng.standard_normal(shape, dtype=np.float32)
    radius = np.sqrt(np.maximum(radius * radius - np.float32(config.height2_mean_m2), 0.0))
    bearing = np.float32(2.0 * np.pi) * rng.random(shape, dtype=np.float32)
    points = agent + radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    if owner < 0:
        points = vrp_between(anchor, points)
        for cloud in points:
            usable = np.hypot(*cloud) > _NEAREST_M
            if not usable.all():
                with np.errstate(divide="ignore"):
                    cloud[...] = cloud[:, systematic(np.log(usable.astype(np.float32)), rng)]
    return Features(
        points,
        unexplained[chosen] * odds / (1.0 + odds),
        np.tile(visibility, (len(chosen), 1)),
        np.full(len(chosen), owner, dtype=np.int64),
        ids[0] + np.arange(len(chosen)),
        np.full(len(chosen), ids[1], dtype=np.int64),
    )


def merged(features: Features, config: ParticleConfig) -> Features:
    """Features nearer to each other than the similarity threshold become one, (48).

    The more accurate belief stays, under the older identity. Only features that are
    known to the threshold themselves are compared: the mean of a feature that is still
    spread over a circle is the circle's middle, which says nothing.
    """
    count = len(features)
    if count < 2:
        return features
    moments = [moments_of(cloud) for cloud in features.points_m]
    mean = np.array([m for m, _ in moments])
    variance = np.array([np.trace(c) for _, c in moments])
    sharp = variance < config.similarity_m**2
    same = np.linalg.norm(mean[:, None] - mean, axis=-1) < config.similarity_m
    same &= (features.owner[:, None] == features.owner) & sharp[:, None] & sharp
    if same.sum() == sharp.sum():
        return features
    features = features.copy()
    keep = np.ones(count, dtype=bool)
    for i in range(count):
        for j in (np.flatnonzero(same[i, i + 1 :]) + i + 1).tolist():
            if keep[i] and keep[j]:
                keep[j] = False
                if variance[j] < variance[i]:
                    features.points_m[i], variance[i] = features.points_m[j], variance[j]
                none = (1.0 - features.existence[i]) * (1.0 - features.existence[j])
                features.existence[i] = 1.0 - none
                features.visibility[i] = np.maximum(features.visibility[i], features.visibility[j])
    return features.take(keep)


def pruned(features: Features, epoch: int, config: ParticleConfig) -> Features:
    """Features without those that hardly exist.

    The prior odds of a new feature are about as small as the threshold, so a feature is
    judged from the epoch after its birth on, when a second path has or has not confirmed it.
    """
    return features.take((features.existence >= config.prune_probability) | (features.born == epoch))
