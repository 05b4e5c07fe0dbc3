"""New features, what is one feature and what is none any more ((3), (46), (48))."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.particle.cloud import Cloud, normals, systematic, total_variance
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.state import Features

__all__ = ["born_features", "merged", "new_odds", "pruned", "vrp_between"]

Array = NDArray[np.float64]
_SMALLEST = np.float32(1e-6)  # squared distance of anchor and virtual anchor, keeps the VRP finite


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
    return np.asarray(
        config.features.new_mean * 2.0 * length_m / config.noise.region_m**2 / config.noise.clutter_density
    )


def vrp_between(anchor: Cloud, virtual: Cloud) -> Cloud:
    """VRPs (2, N) of the walls half-way between anchors and virtual anchors (2, N), (3), RP at 0."""
    vrp = np.empty_like(virtual)
    _half_way(anchor, virtual, vrp)
    return vrp


@compiled
def _half_way(anchor: Cloud, virtual: Cloud, vrp: Cloud) -> None:
    """Fill in the VRPs, (3) in single precision; ``vrp`` may be ``virtual``."""
    for n in range(virtual.shape[1]):
        x, y, u, v = anchor[0, n], anchor[1, n], virtual[0, n], virtual[1, n]
        p, q = u - x, v - y
        scale = (u * u + v * v - (x * x + y * y)) / max(p * p + q * q, _SMALLEST)
        vrp[0, n], vrp[1, n] = scale * p, scale * q


@compiled
def _ring(agent: Cloud, radius: NDArray[np.float32], height2: np.float32, points: Cloud) -> None:
    """Move ``points``, unit vectors, to lengths ``radius`` (in space) from the agent."""
    for n in range(radius.size):
        level = np.sqrt(max(radius[n] * radius[n] - height2, np.float32(0.0)))
        points[0, n] = agent[0, n] + level * points[0, n]
        points[1, n] = agent[1, n] + level * points[1, n]


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
    chosen = np.flatnonzero(unexplained > config.features.detect_threshold)
    odds = new_odds(paths[0][chosen], config)
    points = tuple(
        _on_circle(agent, anchor, owner < 0, paths[0][m], paths[1][m], config, rng) for m in chosen.tolist()
    )
    return Features(
        points,
        unexplained[chosen] * odds / (1.0 + odds),
        np.tile(visibility, (len(chosen), 1)),
        np.full(len(chosen), owner, dtype=np.int64),
        ids[0] + np.arange(len(chosen)),
        np.full(len(chosen), ids[1], dtype=np.int64),
    )


def _on_circle(
    agent: Cloud,
    anchor: Cloud,
    wall: bool,
    length_m: float,
    std_m: float,
    config: ParticleConfig,
    rng: np.random.Generator,
) -> Cloud:
    """Virtual anchors on the circle of a path round the agent, or the walls half-way to them."""
    count = agent.shape[1]
    radius = normals(count, rng)
    radius *= np.float32(std_m)
    radius += np.float32(length_m)
    bearing = np.float32(2.0 * np.pi) * rng.random(count, dtype=np.float32)
    points = np.empty((2, count), np.float32)
    np.cos(bearing, out=points[0])
    np.sin(bearing, out=points[1])
    _ring(agent, radius, np.float32(config.noise.height2_mean_m2), points)
    if not wall:
        return points
    _half_way(anchor, points, points)
    square = points[0] * points[0] + points[1] * points[1]
    if square.min() > config.features.nearest_wall_m**2:
        return points
    with np.errstate(divide="ignore"):
        return points[
            :, systematic(np.log((square > config.features.nearest_wall_m**2).astype(np.float32)), rng)
        ]


def merged(features: Features, config: ParticleConfig) -> Features:
    """Features nearer to each other than the similarity threshold become one, (48).

    The more accurate belief stays, under the older identity. Only features that are
    known to the threshold themselves are compared: the mean of a feature that is still
    spread over a circle is the circle's middle, which says nothing.
    """
    count = len(features)
    if count < 2:
        return features
    moments = [total_variance(cloud) for cloud in features.points_m]
    mean = np.array([place for place, _ in moments])
    variance = np.array([spread for _, spread in moments])
    sharp = variance < config.features.similarity_m**2
    same = np.linalg.norm(mean[:, None] - mean, axis=-1) < config.features.similarity_m
    same &= (features.owner[:, None] == features.owner) & sharp[:, None] & sharp
    if same.sum() == sharp.sum():
        return features
    keep, points = np.ones(count, dtype=bool), list(features.points_m)
    existence, visibility = features.existence.copy(), features.visibility.copy()
    for i in range(count):
        for j in (np.flatnonzero(same[i, i + 1 :]) + i + 1).tolist():
            if keep[i] and keep[j]:
                keep[j] = False
                if variance[j] < variance[i]:
                    points[i], variance[i] = points[j], variance[j]
                existence[i] = 1.0 - (1.0 - existence[i]) * (1.0 - existence[j])
                visibility[i] = np.maximum(visibility[i], visibility[j])
    one = replace(features, points_m=tuple(points), existence=existence, visibility=visibility)
    return one.take(keep)


def pruned(features: Features, epoch: int, config: ParticleConfig) -> Features:
    """Features without those that hardly exist.

    The prior odds of a new feature are about as small as the threshold, so a feature is
    judged from the epoch after its birth on, when a second path has or has not confirmed it.
    """
    return features.take((features.existence >= config.features.prune_probability) | (features.born == epoch))
