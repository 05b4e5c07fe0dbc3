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
    paths = _plain_paths(epoch)
    paths = paths._replace(
        number=np.where(state.located, 0, paths.number),
        std_m=np.maximum(paths.std_m, config.noise.range_std_m),
    )
    associated = np.zeros(paths.length_m.shape, dtype=bool)
    std = float(np.sqrt(0.5 * np.trace(covariance)))
    waiting = state.buffer.of_anchors(~state.located)
    buffer = waiting.with_epoch(epoch.index, mean, std, paths, associated, config.anchors.start_window)
    return replace(state, buffer=buffer)


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
        start_matches=config.anchors.start_matches, start_window=config.anchors.start_window, height_cells=0
    ).widened()
    if not is_due(state.epoch, state.buffer.epochs, bool(state.located.all()), search):
        return state
    layout = Layout(len(state.anchor_names), len(walls))
    given = _search_input(state, layout, _plain_paths(epoch), config)
    found = locate_anchors(_joint(state, walls, layout, config), given, search)
    likeliest = found.located[found.best]
    new = np.flatnonzero(likeliest & ~state.located).tolist()
    if not new:
        return state
    drawn = _mixture(found.keep(np.all(found.located == likeliest, axis=1)), config.inference.particles, rng)
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
        mine = np.flatnonzero(state.buffer.anchor == k)
        epoch, length = state.buffer.epoch[mine], state.buffer.length_m[mine]
        epochs = np.unique(epoch)
        if len(epochs) < 3:
            continue
        first, *later = (np.flatnonzero(epoch == each) for each in epochs[:3])
        reach = 3.0 * config.motion.velocity_std_m_s
        again = [
            np.abs(length[first, None] - length[other]).min(axis=1) < (i + 1) * reach
            for i, other in enumerate(later)
        ]
        lasting = first[again[0] & again[1]]
        if len(lasting) == 0:
            continue
        shortest = lasting[np.argmin(length[lasting])]
        row = state.buffer.row_of(epochs[:1])[0]
        track = state.buffer.track
        std = np.hypot(state.buffer.std_m[mine[shortest]], track.std_m[row])
        radius = length[shortest] + std * normals(config.inference.particles, rng)
        radius = np.sqrt(np.maximum(radius**2 - config.noise.height2_mean_m2, 0.0))
        turn = 2.0 * np.pi * rng.random(config.inference.particles if located.any() else 1)
        ring = track.position_m[row][:, None] + radius * np.stack([np.cos(turn), np.sin(turn)])
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
        mean[layout.anchor(k)] = NOWHERE_M, 0.0, config.noise.height2_mean_m2, 0.0
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


def _plain_paths(epoch: Epoch) -> EpochPaths:
    """The paths of an epoch without their powers."""
    paths = stack_paths(epoch, _ANY_CARRIER_HZ)
    return paths._replace(excess_loss_db=np.full_like(paths.length_m, np.nan))


def _search_input(
    state: ParticleState, layout: Layout, paths: EpochPaths, config: ParticleConfig
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
        heard=state.buffer,
        gain_offset_db=np.full(layout.anchors, np.nan),
        noise=config.noise,
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
