"""Where the anchors may be at the start: known, on a ring, or found by their paths (IV-B1).

An unknown anchor's candidates are those of the paper: every path puts a virtual anchor
on a circle round the agent, (11); every wall takes that circle to one of anchors, (4);
where the circles of three or more paths meet is the anchor. The search runs over the
mirrored circles, whose centres are the agent's images in the walls, in the robust form of
:func:`estimator.slam.anchors.search.locate`: all pairs of circles are intersected, all paths
vote, clutter and missed paths are allowed for, and the path that is the line of sight is
found rather than assumed to be the shortest.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch
from estimator.slam.anchors.circles import Centres, images_of_agent
from estimator.slam.anchors.search import Candidates, locate
from estimator.slam.anchors.sight import PathBatch
from estimator.slam.config import GaussianConfig
from estimator.slam.particle.cloud import Cloud, gaussian_cloud, moments_of, systematic
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.state import ParticleState

__all__ = ["locate_anchors", "remember_paths", "ring_anchors"]

Array = NDArray[np.float64]


def remember_paths(state: ParticleState, epoch: Epoch, config: ParticleConfig) -> ParticleState:
    """The state with this epoch's paths of anchors that are not located, old ones forgotten."""
    mean, covariance = moments_of(state.agent[:2])
    place = [epoch.index, *mean, 0.5 * np.trace(covariance)]
    new = [
        [*place, k, length, max(std, config.range_std_m)]
        for k in np.flatnonzero(~state.located)
        for length, std in zip(epoch.paths[k].range_m, epoch.paths[k].range_std_m, strict=True)
    ]
    past = np.concatenate([state.past, np.array(new, dtype=np.float64).reshape(-1, 7)])
    recent = (past[:, 0] > epoch.index - config.start_window) & ~state.located[past[:, 4].astype(np.int64)]
    return replace(state, past=past[recent])


def locate_anchors(state: ParticleState, config: ParticleConfig, rng: np.random.Generator) -> ParticleState:
    """Locate the anchors that are not, if enough of their remembered paths agree.

    Candidates become a mixture of Gaussian clouds, weighted by their evidence. This epoch
    alone is tried first, then the whole window.

    Parameters
    ----------
    state : ParticleState
        State with remembered paths.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of randomness.
    """
    sure = state.features.existence >= config.detect_threshold
    moments = [moments_of(cloud) for cloud in state.features.points_m[sure]]
    walls = np.array([mean for mean, _ in moments]).reshape(-1, 2)
    spread = np.array([covariance for _, covariance in moments]).reshape(-1, 2, 2)
    if len(walls) == 0:
        return state
    anchors, located = state.anchors_m.copy(), state.located.copy()
    for k in np.flatnonzero(~state.located):
        mine = state.past[state.past[:, 4] == k]
        for window in (mine[mine[:, 0] == state.epoch], mine):
            found = _candidates(window, walls, spread, config)
            if found is not None:
                anchors[k] = _mixture(found, config, rng)
                located[k] = True
                break
    return replace(state, anchors_m=anchors, located=located)


def ring_anchors(state: ParticleState, config: ParticleConfig, rng: np.random.Generator) -> ParticleState:
    """Put anchors on rings round the agent, where nothing tells their bearing.

    The ring's radius is the shortest path of the oldest remembered epoch that was heard
    again, within what the agent can have moved, in the two epochs after. The first anchor
    gets a bearing drawn at random: it fixes the rotation, which nothing else does.

    Parameters
    ----------
    state : ParticleState
        State with remembered paths.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of randomness.
    """
    anchors, located = state.anchors_m.copy(), state.located.copy()
    for k in np.flatnonzero(~state.located):
        mine = state.past[state.past[:, 4] == k]
        epochs = np.unique(mine[:, 0])
        if len(epochs) < 3:
            continue
        first, *later = (mine[mine[:, 0] == epoch] for epoch in epochs[:3])
        reach = 3.0 * config.velocity_std_m_s
        again = [
            np.abs(first[:, 5, None] - other[:, 5]).min(axis=1) < (i + 1) * reach
            for i, other in enumerate(later)
        ]
        lasting = first[again[0] & again[1]]
        if len(lasting) == 0:
            continue
        shortest = lasting[np.argmin(lasting[:, 5])]
        std = np.sqrt(shortest[6] ** 2 + shortest[3])
        radius = shortest[5] + std * rng.standard_normal(config.particles)
        radius = np.sqrt(np.maximum(radius**2 - config.height2_mean_m2, 0.0))
        turn = 2.0 * np.pi * rng.random(config.particles if located.any() else 1)
        anchors[k] = shortest[1:3, None] + radius * np.stack([np.cos(turn), np.sin(turn)])
        located[k] = True
    return replace(state, anchors_m=anchors, located=located)


def _candidates(paths: Array, walls: Array, spread: Array, config: ParticleConfig) -> Candidates | None:
    """Places from which the remembered paths of an anchor make sense, if there are any."""
    epochs, first = np.unique(paths[:, 0], return_index=True)
    if len(epochs) == 0:
        return None
    numbers = np.arange(len(walls))
    parts = [
        images_of_agent(row[1:3], float(row[3]), walls, spread, numbers, int(row[0])) for row in paths[first]
    ]
    centres = Centres(
        *(np.concatenate([getattr(part, entry.name) for part in parts]) for entry in fields(Centres))
    )
    batch = PathBatch(
        np.sqrt(np.maximum(paths[:, 5] ** 2 - config.height2_mean_m2, 0.0)),
        paths[:, 6] ** 2,
        paths[:, 0].astype(np.int64),
        np.full(len(paths), np.nan),
    )
    models = GaussianConfig(
        range_std_m=config.range_std_m,
        detection_probability=config.detection_probability,
        clutter_mean=config.clutter_mean,
        region_m=config.region_m,
        height2_mean_m2=config.height2_mean_m2,
    )
    found = locate(centres, batch, dict(enumerate(walls)), models, epochs[-1:].astype(np.int64))
    enough = found.matches >= config.start_matches * min(len(epochs), 2)
    if not enough.any():
        return None
    return Candidates(*(getattr(found, entry.name)[enough] for entry in fields(found)))


def _mixture(found: Candidates, config: ParticleConfig, rng: np.random.Generator) -> Cloud:
    """A cloud (2, N) of the candidates, each with its share of the evidence."""
    share = np.exp(found.log_evidence - found.log_evidence.max())
    fine = np.repeat(share / share.sum(), config.particles) / config.particles
    parent = systematic(np.log(np.maximum(fine, 1e-300)), rng)[:: len(share)] // config.particles
    cloud = np.empty((2, config.particles), np.float32)
    for s in np.unique(parent):
        members = np.flatnonzero(parent == s)
        cloud[:, members] = gaussian_cloud(found.mean_m[s], found.covariance_m2[s], len(members), rng)
    return cloud[:, rng.permutation(config.particles)]
