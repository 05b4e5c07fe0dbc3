"""Where the anchors may be at the start: known, on a ring, or found by their paths (IV-B1).

An unknown anchor's candidates are those of the paper: every path puts a virtual anchor
on a circle round the agent, (11); every wall takes that circle to one of anchors, (4);
where the circles of three or more paths meet is the anchor. Which of them it is, and under which
labels of the paths, is weighed as :func:`estimator.slam.anchors.locate.locate_anchors` does for
the ``gaussian`` engine: in one joint Gaussian of agent, anchors and walls. Not so the paper, which holds
the walls where they were sensed: then each anchor is turned by the errors of the walls it was located
with, and beliefs that are independent ever after do not turn it back (in the paper's room .017 rad, three
times what the walls' bearings tell together).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch
from estimator.slam.anchors.locate import locate_anchors, may_locate
from estimator.slam.config import GaussianConfig
from estimator.slam.gaussian.paths import stack_paths
from estimator.slam.gaussian.start import state_of
from estimator.slam.gaussian.state import NOWHERE_M, GaussianState, Rows
from estimator.slam.layout import Layout
from estimator.slam.particle.cloud import Cloud, gaussian_cloud, moments_of, normals, systematic
from estimator.slam.particle.config import ParticleConfig
from estimator.slam.particle.found import found_walls
from estimator.slam.particle.state import ParticleState

__all__ = ["remember_paths", "ring_anchors", "start_anchors"]

Array = NDArray[np.float64]
_ANY_CARRIER_HZ = 1e9  # turns gains into losses, which this engine does not use


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


def start_anchors(
    state: ParticleState, epoch: Epoch, config: ParticleConfig, rng: np.random.Generator
) -> ParticleState:
    """Locate the anchors that are not, if enough of this epoch's and the remembered paths agree.

    Anchors and walls are drawn from a mixture of Gaussians, a share for each place and labelling of the
    paths: what an anchor's paths tell of the walls goes to the walls.

    Parameters
    ----------
    state : ParticleState
        State with remembered paths.
    epoch : Epoch
        The epoch.
    config : ParticleConfig
        Models.
    rng : Generator
        Source of randomness.
    """
    walls = found_walls(state, config)
    if not walls:
        return state
    models = GaussianConfig(
        range_std_m=config.range_std_m,
        detection_probability=config.detection_probability,
        clutter_mean=config.clutter_mean,
        region_m=config.region_m,
        height2_mean_m2=config.height2_mean_m2,
        start_matches=config.start_matches,
        start_window=config.start_window,
    ).widened()
    joint = _joint(state, walls, models)
    if not may_locate(joint):
        return state
    table = stack_paths(epoch, joint.carrier_hz)
    table = replace(table, excess_loss_db=np.full_like(table.excess_loss_db, np.nan))
    rows = locate_anchors(joint, table, models).rows
    likeliest = rows.located[rows.best]
    new = np.flatnonzero(likeliest & ~state.located).tolist()
    if not new:
        return state
    drawn = _mixture(rows.keep(np.all(rows.located == likeliest, axis=1)), config.particles, rng)
    anchors, points, layout = list(state.anchors_m), list(state.features.points_m), joint.layout
    for k in new:
        anchors[k] = _untied(drawn[layout.anchor_xy(k)], rng)
    for slot, j in enumerate(walls):
        points[j] = _untied(drawn[layout.wall(slot)], rng)
    features = replace(state.features, points_m=tuple(points))
    return replace(state, anchors_m=tuple(anchors), located=likeliest.copy(), features=features)


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
    anchors, located = list(state.anchors_m), state.located.copy()
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
        radius = shortest[5] + std * normals(config.particles, rng)
        radius = np.sqrt(np.maximum(radius**2 - config.height2_mean_m2, 0.0))
        turn = 2.0 * np.pi * rng.random(config.particles if located.any() else 1)
        ring = shortest[1:3, None] + radius * np.stack([np.cos(turn), np.sin(turn)])
        anchors[k] = ring.astype(np.float32)
        located[k] = True
    return replace(state, anchors_m=tuple(anchors), located=located)


def _joint(
    state: ParticleState, walls: dict[int, tuple[Array, Array]], models: GaussianConfig
) -> GaussianState:
    """The beliefs' moments as one Gaussian, with what is remembered."""
    layout = Layout(len(state.anchor_names), len(walls))
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    parts = [(layout.AGENT, moments_of(state.agent))]
    parts += [(layout.wall(slot), moments) for slot, moments in enumerate(walls.values())]
    for k, located in enumerate(state.located.tolist()):
        mean[layout.anchor(k)] = NOWHERE_M, 0.0, models.height2_mean_m2, 0.0
        if located:
            parts.append((layout.anchor_xy(k), moments_of(state.anchors_m[k])))
    for place, (own, spread) in parts:
        mean[place], covariance[place, place] = own, spread
    past = state.past[state.past[:, 0] < state.epoch]
    epoch, x, y, variance, anchor, length, std = past.T
    first = np.unique(epoch, return_index=True)[1]
    return replace(
        state_of(layout, mean, covariance, state.anchor_names, state.located, _ANY_CARRIER_HZ, models),
        epoch=state.epoch,
        trail=np.stack([epoch, x, y, np.sqrt(variance)], axis=1)[first],
        heard=np.stack([epoch, anchor, length, std, np.full(len(past), np.nan), np.ones(len(past))], axis=1),
    )


def _mixture(rows: Rows, count: int, rng: np.random.Generator) -> Cloud:
    """Draws (n, N) from the rows' Gaussians, of each its weight's share."""
    members = np.bincount(systematic(rows.log_weight, rng, count), minlength=len(rows))
    parts = [
        gaussian_cloud(mean, covariance, size, rng)
        for mean, covariance, size in zip(rows.mean, rows.covariance, members.tolist(), strict=True)
    ]
    return np.concatenate(parts, axis=1)


def _untied(cloud: Cloud, rng: np.random.Generator) -> Cloud:
    """The particles in another order: belief propagation takes the beliefs of nodes as independent."""
    return np.asarray(cloud[:, rng.permutation(cloud.shape[1])])
