"""One anchor's paths and the beliefs: association and messages ((28)-(31), (42)-(47)).

The factor of a path couples three nodes, agent ``u``, anchor ``a`` and wall ``v`` (or two,
for the line of sight and for virtual anchors). Its messages are integrals over the other
nodes, estimated by pairing particles (:mod:`estimator.slam.particle.pairings` has the loops).
Likelihoods are computed twice, for the association and for the messages that it decides, so that memory
does not grow with the paths: beside the messages it is pairings x N numbers of four bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.association.belief_propagation import associate
from estimator.slam.particle.cloud import Cloud
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.pairings import (
    SIGHT,
    VIRTUAL,
    WALL,
    likelihood_sum,
    paired_lengths,
    paired_weights,
)

__all__ = ["Messages", "Nodes", "exchange"]

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
    points : tuple of ndarray of float32, shape (2, N)
        Of each feature: VRPs if ``shared``, virtual anchors of this anchor otherwise.
    shared : bool
        Whether features are walls, common to all anchors.
    existence, visibility : ndarray, shape (F,)
        Probabilities that the feature exists and that this anchor can be heard over it.
    fixed : bool
        Whether the anchor is known: then nothing is told to it.
    """

    agent: Cloud
    anchor: Cloud
    points: tuple[Cloud, ...]
    shared: bool
    existence: Array
    visibility: Array
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class Messages:
    """What the paths of one anchor say.

    Parameters
    ----------
    agent, anchor : ndarray of float32, shape (N,)
        Log weights of the agent's and the anchor's particles; empty of an anchor that is known.
    points : tuple of ndarray of float32, shape (N,), or None
        Log weights of the features' particles; None where no path is in the gate.
    existence, visibility : ndarray, shape (F,)
        Posterior probabilities.
    unexplained : ndarray, shape (M,)
        Probability that no legacy feature gave the path.
    log_evidence : float
        Log of the evidence over "all is clutter".
    """

    agent: NDArray[np.float32]
    anchor: NDArray[np.float32]
    points: tuple[NDArray[np.float32] | None, ...]
    existence: Array
    visibility: Array
    unexplained: Array
    log_evidence: float


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
    shifts = np.zeros((config.inference.pairings, 2), dtype=np.int64)  # of anchor and features
    shifts[1:] = rng.integers(particles, size=(config.inference.pairings - 1, 2))
    height2 = np.float32(config.noise.height2_mean_m2)
    path_m, scale = length_m.astype(np.float32), (np.sqrt(0.5) / std_m).astype(np.float32)
    margin = config.inference.gate_sigma * std_m
    peak = 1.0 / (
        np.sqrt(2.0 * np.pi) * std_m * config.noise.clutter_density
    )  # largest ratio of path over clutter

    # (45), integrated over all nodes: beta(a = m) over beta(a = 0) of each feature
    features, gate = len(nodes.existence), []
    likelihood = np.zeros((features, len(length_m)))
    lengths = np.empty((config.inference.pairings, particles), np.float32)
    for f in range(features):
        least, most = paired_lengths(*_of(nodes, f), shifts, height2, lengths)
        gate.append(np.flatnonzero((length_m + margin > least) & (length_m - margin < most)))
        for m in gate[f].tolist():
            total = likelihood_sum(lengths.ravel(), path_m[m], scale[m])
            likelihood[f, m] = peak[m] * total / lengths.size
    detect = nodes.visibility * config.noise.detection_probability
    silent = 1.0 - nodes.existence * detect
    ratio = (nodes.existence * detect / silent)[:, None] * likelihood
    odds = ratio / (1.0 + new_ratio)
    probability, message = np.empty(odds.shape), np.empty(odds.shape)
    contest = associate(odds, probability, message, 30)
    share = detect[:, None] * message / (1.0 + new_ratio)

    told = np.sum(share * likelihood, axis=1)  # visible and heard
    mean = 1.0 - detect + told
    existence = nodes.existence * mean / (nodes.existence * mean + 1.0 - nodes.existence)
    missed = nodes.visibility * (1.0 - config.noise.detection_probability)
    visibility = np.minimum((missed + told) / mean, 1.0)

    none = np.empty(0, np.float32)
    agent, anchor = np.zeros(particles, np.float32), np.zeros(0 if nodes.fixed else particles, np.float32)
    to_agent, to_anchor = np.empty_like(agent), np.empty_like(anchor)
    points: list[NDArray[np.float32] | None] = []
    for f, near in enumerate(gate):
        to_point = np.empty(particles, np.float32) if f and near.size else none
        if near.size:
            paired_weights(
                *_of(nodes, f),
                shifts,
                height2,
                (path_m[near], scale[near], (share[f] * peak)[near].astype(np.float32)),
                np.float32(1.0 - detect[f]),
                np.float32(nodes.existence[f]),
                (to_agent, to_anchor, to_point),
            )
            agent += np.log(to_agent, out=to_agent)
            anchor += np.log(to_anchor, out=to_anchor)
        if f:
            points.append(np.log(to_point, out=to_point) if near.size else None)
    evidence = float(contest + np.sum(np.log(silent)) + np.sum(np.log1p(new_ratio)))
    unexplained = np.clip(1.0 - probability.sum(axis=0), 0.0, 1.0)
    return Messages(agent, anchor, tuple(points), existence, visibility, unexplained, evidence)


def _of(nodes: Nodes, f: int) -> tuple[Cloud, Cloud, Cloud, int]:
    """Agent, anchor and feature ``f``, and what kind of feature it is."""
    if f == 0:
        return nodes.agent, nodes.anchor, nodes.anchor, SIGHT
    return nodes.agent, nodes.anchor, nodes.points[f - 1], WALL if nodes.shared else VIRTUAL
