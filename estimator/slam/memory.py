"""What an epoch leaves behind for later steps: the track, the unexplained, the spans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths, reflect, wall_side
from estimator.slam.layout import Layout
from estimator.slam.paths import PathTable
from estimator.slam.pool import Pool, active_of
from estimator.slam.state import GaussianState
from estimator.slam.update import predicted_variance

__all__ = ["clutter_density", "remember", "widen_spans", "widen_stretches"]

Array = NDArray[np.float64]

_FLOOD = 200  # paths of one anchor in one epoch
_UNKNOWN_PATHS = 6.0  # expected of an anchor beyond clutter, before any wall is known
_PRIOR_EPOCHS = 4.0  # that this expectation weighs


def clutter_density(state: GaussianState, config: GaussianConfig) -> Array:
    """Intensity (K,) per metre of paths that no known feature gives: clutter, and walls not yet found.

    Recent epochs tell how many there are. With no wall on the map, most paths are such; they
    must not be taken for the line of sight.
    """
    expected = config.clutter_mean + (0.0 if state.slots.confirmed.any() else _UNKNOWN_PATHS)
    epochs = len(state.trail)
    counts = np.bincount(state.loose[:, 1].astype(np.int64), minlength=state.layout.anchors)
    rate = (counts + _PRIOR_EPOCHS * expected) / (epochs + _PRIOR_EPOCHS)
    return np.asarray(np.maximum(rate, config.clutter_mean) / config.region_m + 1e-12)


def widen_spans(span_m: Array, mean: Array, heard: Array, layout: Layout) -> Array:
    """Spans (B, L, 2) of the walls of runs after the bounces that their best rows heard.

    Parameters
    ----------
    span_m : ndarray, shape (B, L, 2)
        Spans before.
    mean : ndarray, shape (B, n)
        The row to believe, of each run.
    heard : ndarray, shape (B, K, F)
        Probability that each feature was measured.
    layout : Layout
        Positions in the state vectors.
    """
    span = span_m.copy()
    if not layout.shared:
        return span
    agent = mean[:, None, layout.POSITION]
    wall = mean[:, layout.walls].reshape(len(mean), layout.slots, 2)
    normal = wall / np.linalg.norm(wall, axis=-1, keepdims=True)
    side = wall_side(agent, wall)
    for k in range(layout.anchors):
        image = reflect(mean[:, None, layout.anchor_xy(k)], wall)
        other = wall_side(image, wall)
        gap = np.where(side == other, 1.0, side - other)
        bounce = agent + (side / gap)[..., None] * (image - agent)
        along = bounce[..., 1] * normal[..., 0] - bounce[..., 0] * normal[..., 1]
        hit = heard[:, k, 1 : 1 + layout.slots] > 0.5
        span[..., 0] = np.where(hit, np.minimum(span[..., 0], along), span[..., 0])
        span[..., 1] = np.where(hit, np.maximum(span[..., 1], along), span[..., 1])
    return span


def widen_stretches(heard_from_m: Array, mean: Array, heard: Array, layout: Layout) -> Array:
    """Where the agents of runs first and last heard their walls, after what their best rows heard.

    Parameters
    ----------
    heard_from_m : ndarray, shape (B, L, K, 2, 2)
        First and last places before, NaN if there were none.
    mean, heard, layout
        As for :func:`widen_spans`.
    """
    hit = np.swapaxes(heard[:, :, 1 : 1 + layout.slots] > 0.5, 1, 2)  # (B, L, K)
    new = np.isnan(heard_from_m[..., 0]) & hit[..., None]
    use = np.stack([new[..., 0], hit], axis=-1)[..., None]
    return np.where(use, mean[:, None, None, None, layout.POSITION], heard_from_m)


def remember(
    states: Sequence[GaussianState],
    paths: Sequence[PathTable],
    explained: Sequence[Array],
    config: GaussianConfig,
) -> list[GaussianState]:
    """Note where the agents of runs with one layout are and what nothing explains.

    A path counts as explained if a feature probably gave it, or if it lies close to
    where any possible feature would be heard: beside a known path stand its echoes,
    not new walls. Of an anchor that hears hundreds of paths nothing is noted: in a flood every
    wall could be found, and searching it takes minutes.

    Parameters
    ----------
    states : sequence of GaussianState
        States with corrected rows.
    paths : sequence of PathTable
        The epoch's paths of each.
    explained : sequence of ndarray, shapes (K, M)
        Probability that the best row explains each path.
    config : GaussianConfig
        ``pair_radius_m`` and the windows.
    """
    layout = states[0].layout
    pool = Pool.of_best(states)
    mean, covariance = pool.rows.mean, pool.rows.covariance
    std = np.sqrt(0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]))
    prediction = predict_paths(mean, layout)
    spread = predicted_variance(prediction, covariance)
    beside = config.pair_radius_m if layout.shared else 2.0 * config.range_std_m
    radius = np.minimum(beside + 2.0 * np.sqrt(spread), 3.0)
    radius = np.where(active_of(pool, states, layout) & prediction.possible, radius, 0.0)
    window = config.birth_window if layout.shared else config.virtual_window
    after = []
    for b, (state, table, known) in enumerate(zip(states, paths, explained, strict=True)):
        trail = np.concatenate([state.trail, [[state.epoch, mean[b, 0], mean[b, 1], std[b]]]])
        distance = np.abs(table.length_m[:, None, :] - prediction.length_m[b][..., None])
        near = np.any(distance < radius[b][..., None], axis=1)
        taken = pool.rows.located[b][:, None] & (near | (known > 0.3))
        flood = np.sum(table.valid, axis=1) > _FLOOD
        k, j = np.nonzero(table.valid & ~flood[:, None])
        columns = (table.length_m[k, j], table.std_m[k, j], table.excess_loss_db[k, j], ~taken[k, j])
        heard = np.concatenate([state.heard, np.stack([np.full(k.size, state.epoch), k, *columns], axis=1)])
        oldest = state.epoch - max(window, config.start_window)
        after.append(replace(state, trail=trail[trail[:, 0] > oldest], heard=heard[heard[:, 0] > oldest]))
    return after
