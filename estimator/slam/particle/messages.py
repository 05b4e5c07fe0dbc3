"""One anchor's paths and the beliefs: association and messages ((28)-(31), (42)-(47)).

The factor of a path couples three nodes, agent ``u``, anchor ``a`` and wall ``v`` (or two,
for the line of sight and for virtual anchors). Its messages are integrals over the other
nodes, estimated by pairing particles of equal index.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.association import associate
from estimator.slam.particle.cloud import Cloud
from estimator.slam.particle.config import ParticleConfig

__all__ = ["Messages", "Nodes", "exchange", "images"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Nodes:
    """Beliefs that the paths of one anchor inform; F = 1 + L, the line of sight first.

    Parameters
    ----------
    agent : ndarray of float32, shape (2, N)
        Positions.
    anchor : ndarray of float32, shape (2, N)
        The anchor.
    points : ndarray of float32, shape (L, 2, N)
        VRPs if ``shared``, virtual anchors of this anchor otherwise.
    shared : bool
        Whether features are walls, common to all anchors.
    existence, visibility : ndarray, shape (F,)
        Probabilities that the feature exists and that this anchor can be heard over it.
    """

    agent: Cloud
    anchor: Cloud
    points: Cloud
    shared: bool
    existence: Array
    visibility: Array


@dataclass(frozen=True, eq=False)
class Messages:
    """What the paths of one anchor say.

    Parameters
    ----------
    agent, anchor : ndarray of float32, shape (N,)
        Log weights of the agent's and the anchor's particles.
    points : ndarray of float32, shape (L, N)
        Log weights of the features' particles.
    existence, visibility : ndarray, shape (F,)
        Posterior probabilities.
    unexplained : ndarray, shape (M,)
        Probability that no legacy feature gave the path.
    log_evidence : float
        Log of the evidence over "all is clutter".
    """

    agent: NDArray[np.float32]
    anchor: NDArray[np.float32]
    points: NDArray[np.float32]
    existence: Array
    visibility: Array
    unexplained: Array
    log_evidence: float


def images(anchor: Cloud, vrp: Cloud) -> Cloud:
    """Virtual anchors (2): mirror images of anchors (..., 2, N) in walls (..., 2, N), RP at 0."""
    square = vrp[..., 0, :] ** 2 + vrp[..., 1, :] ** 2
    along = anchor[..., 0, :] * vrp[..., 0, :] + anchor[..., 1, :] * vrp[..., 1, :]
    scale = 1.0 - 2.0 * along / np.maximum(square, np.float32(1e-6))
    return np.asarray(anchor + scale[..., None, :] * vrp)


def exchange(
    nodes: Nodes,
    length_m: Array,
    std_m: Array,
    new_ratio: Array,
    config: ParticleConfig,
    rng: np.random.Generator,
) -> Messages:
    """Associate the paths of one anchor and weigh the particles of all nodes.

    Parameters
    ----------
    nodes : Nodes
        Predicted beliefs.
    length_m, std_m : ndarray, shape (M,)
        Path lengths and their standard deviations.
    new_ratio : ndarray, shape (M,)
        Odds that an unexplained path is a new feature rather than clutter, (46).
    config : ParticleConfig
        Models.
    rng : Generator
        Draws the pairings beyond the first.

    Returns
    -------
    Messages
    """
    particles = nodes.agent.shape[1]
    shifts = np.zeros((config.pairings, 2), dtype=np.int64)  # of anchor and features
    shifts[1:] = rng.integers(particles, size=(config.pairings - 1, 2))
    likelihood = _likelihoods(nodes, shifts, length_m, std_m, config)

    # (45), integrated over all nodes: beta(a = m) over beta(a = 0) of each feature
    features = len(nodes.existence)
    detect = nodes.visibility * config.detection_probability
    silent = 1.0 - nodes.existence * detect
    ratio = np.zeros((features, len(length_m)))
    for (f, m), values in likelihood.items():
        ratio[f, m] = nodes.existence[f] * detect[f] / silent[f] * values.mean(dtype=np.float64)
    association = associate(ratio / (1.0 + new_ratio), iterations=30)
    message = association.message / (1.0 + new_ratio)

    agent, anchor = np.zeros(particles, np.float32), np.zeros(particles, np.float32)
    points = np.zeros((features - 1, particles), np.float32)
    existence, visibility = nodes.existence.copy(), nodes.visibility.copy()
    for f in range(features):
        heard = [(m, values) for (g, m), values in likelihood.items() if g == f]
        weight = np.full(heard[0][1].shape if heard else (1, 1), 1.0 - detect[f], np.float32)
        for m, values in heard:
            weight += np.float32(detect[f] * message[f, m]) * values
        mean = float(weight.mean(dtype=np.float64))
        existence[f] = nodes.existence[f] * mean / (nodes.existence[f] * mean + 1.0 - nodes.existence[f])
        told = mean - (1.0 - detect[f])  # visible and heard
        missed = nodes.visibility[f] * (1.0 - config.detection_probability)
        visibility[f] = min((missed + told) / mean, 1.0)
        if not heard:
            continue
        with_absence = np.float32(nodes.existence[f]) * weight + np.float32(1.0 - nodes.existence[f])
        agent += np.log(with_absence.mean(axis=0))
        anchor += np.log(_back(with_absence, shifts[:, 0]))
        if f > 0:
            points[f - 1] = np.log(_back(weight, shifts[:, 1]))
    evidence = float(association.log_evidence + np.sum(np.log(silent)) + np.sum(np.log1p(new_ratio)))
    unexplained = np.clip(1.0 - association.probability.sum(axis=0), 0.0, 1.0)
    return Messages(agent, anchor, points, existence, visibility, unexplained, evidence)


def _likelihoods(
    nodes: Nodes, shifts: NDArray[np.int64], length_m: Array, std_m: Array, config: ParticleConfig
) -> dict[tuple[int, int], NDArray[np.float32]]:
    """Likelihood ratio of path over clutter, (S, N) for each pair (feature, path) in the gate."""
    result = {}
    height2 = np.float32(config.height2_mean_m2)
    for f in range(len(nodes.existence)):
        distance = np.empty((len(shifts), nodes.agent.shape[1]), np.float32)
        for row, (a, b) in zip(distance, shifts, strict=True):
            source = np.roll(nodes.anchor, a, axis=-1) if a else nodes.anchor
            if f > 0:
                point = np.roll(nodes.points[f - 1], b, axis=-1) if b else nodes.points[f - 1]
                source = images(source, point) if nodes.shared else point
            x, y = nodes.agent - source
            np.sqrt(x * x + y * y + height2, out=row)
        margin = config.gate_sigma * std_m
        near = (length_m + margin > distance.min()) & (length_m - margin < distance.max())
        for m in np.flatnonzero(near).tolist():
            scaled = (distance - np.float32(length_m[m])) * np.float32(np.sqrt(0.5) / std_m[m])
            peak = 1.0 / (np.sqrt(2.0 * np.pi) * std_m[m] * config.clutter_density)
            result[f, m] = np.float32(peak) * np.exp(-scaled * scaled)
    return result


def _back(values: NDArray[np.float32], shifts: NDArray[np.int64]) -> NDArray[np.float32]:
    """Average over pairings (S, N) for the node that was shifted."""
    if len(shifts) == 1:
        return np.asarray(values[0])
    rolled = [np.roll(row, -s) for row, s in zip(values, shifts.tolist(), strict=True)]
    return np.asarray(np.mean(rolled, axis=0))
