"""Where the anchors may be at the start: known, on a ring, or found by their paths (IV-B1).

An unknown anchor's candidates are those of the paper: every path puts a virtual anchor
on a circle round the agent, (11); every wall takes that circle to one of anchors, (4);
where the circles of three or more paths meet is the anchor. Which of them it is, and under which
labels of the paths, is weighed as :func:`estimator.slam.anchors.locate_anchors` does for
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
from estimator.slam.anchors import AnchorSearchConfig, SearchInput, is_due, locate_anchors
from estimator.slam.mixture_reduction import Reduction, reduce_mixture, reduction_model
from estimator.slam.models.epoch_paths import EpochPaths, stack_paths
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.noise import MeasurementNoise
from estimator.slam.models.path_buffer import PathBuffer, Track
from estimator.slam.models.state_vector import AGENT, NOWHERE_M, Layout
from estimator.slam.models.visibility import Visibility, prior_visibility
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
    search = AnchorSearchConfig(
        start_matches=config.start_matches, start_window=config.start_window, height_cells=0
    ).widened()
    buffer = _buffer(state)
    if not is_due(state.epoch, buffer.epochs, bool(state.located.all()), search):
        return state
    layout = Layout(len(state.anchor_names), len(walls))
    paths = stack_paths(epoch, _ANY_CARRIER_HZ)
    given = _search_input(
        state, layout, paths._replace(excess_loss_db=np.full_like(paths.length_m, np.nan)), buffer, config
    )
    found = locate_anchors(_joint(state, walls, layout, config), given, search)
    likeliest = found.located[found.best]
    new = np.flatnonzero(likeliest & ~state.located).tolist()
    if not new:
        return state
    drawn = _mixture(found.keep(np.all(found.located == likeliest, axis=1)), config.particles, rng)
    anchors, points = list(state.anchors_m), list(state.features.points_m)
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
    state: ParticleState, walls: dict[int, tuple[Array, Array]], layout: Layout, config: ParticleConfig
) -> Hypotheses:
    """The beliefs' moments as one Gaussian."""
    mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    parts = [(AGENT, moments_of(state.agent))]
    parts += [(layout.wall(slot), moments) for slot, moments in enumerate(walls.values())]
    for k, located in enumerate(state.located.tolist()):
        mean[layout.anchor(k)] = NOWHERE_M, 0.0, config.height2_mean_m2, 0.0
        if located:
            parts.append((layout.anchor_xy(k), moments_of(state.anchors_m[k])))
    for place, (own, spread) in parts:
        mean[place], covariance[place, place] = own, spread
    prior = prior_visibility(layout, Visibility())
    return Hypotheses(
        np.zeros(1),
        mean[None],
        covariance[None],
        state.located[None].copy(),
        np.ones((1, layout.slots), dtype=bool),
        np.tile(prior, (1, layout.anchors, 1)),
        np.zeros((1, layout.slots), dtype=np.int64),
    )


def _buffer(state: ParticleState) -> PathBuffer:
    """What is remembered, as the search takes it."""
    past = state.past[state.past[:, 0] < state.epoch]
    epoch, x, y, variance, anchor, length, std = past.T
    first = np.unique(epoch, return_index=True)[1]
    place = np.stack([x, y], axis=1)[first]
    return PathBuffer(
        Track(epoch[first].astype(np.int64), place, np.sqrt(variance[first])),
        epoch.astype(np.int64),
        anchor.astype(np.int64),
        length.copy(),
        std.copy(),
        np.full(len(past), np.nan),
        np.ones(len(past), dtype=bool),
    )


def _search_input(
    state: ParticleState, layout: Layout, paths: EpochPaths, buffer: PathBuffer, config: ParticleConfig
) -> SearchInput:
    """What this engine tells the search of itself."""
    reduction = Reduction()
    model = reduction_model(
        reduction, layout, reduction.prune_nats, reduction.alike_sigma, 2 * reduction.max_hypotheses
    )

    def reduce(many: Hypotheses) -> Hypotheses:
        return reduce_mixture(many, model)

    return SearchInput(
        layout=layout,
        confirmed=np.ones(layout.slots, dtype=bool),
        epoch=state.epoch,
        paths=paths,
        heard=buffer,
        gain_offset_db=np.full(layout.anchors, np.nan),
        noise=MeasurementNoise(
            range_std_m=config.range_std_m,
            detection_probability=config.detection_probability,
            clutter_mean=config.clutter_mean,
            region_m=config.region_m,
            height2_mean_m2=config.height2_mean_m2,
        ),
        fresh_visibility=prior_visibility(layout, Visibility()),
        prune_nats=reduction.prune_nats,
        reduce=reduce,
    )


def _mixture(found: Hypotheses, count: int, rng: np.random.Generator) -> Cloud:
    """Draws (n, N) from the hypotheses' Gaussians, of each its weight's share."""
    members = np.bincount(systematic(found.log_weight, rng, count), minlength=found.number)
    parts = [
        gaussian_cloud(mean, covariance, size, rng)
        for mean, covariance, size in zip(found.mean, found.covariance, members.tolist(), strict=True)
    ]
    return np.concatenate(parts, axis=1)


def _untied(cloud: Cloud, rng: np.random.Generator) -> Cloud:
    """The particles in another order: belief propagation takes the beliefs of nodes as independent."""
    return np.asarray(cloud[:, rng.permutation(cloud.shape[1])])
