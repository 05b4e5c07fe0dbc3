"""What an epoch leaves behind for later steps: the track, the unexplained, the spans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths, reflect, wall_side
from estimator.slam.paths import PathTable
from estimator.slam.state import GaussianState
from estimator.slam.update import predicted_variance

__all__ = ["clutter_density", "remember", "widen_spans"]

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


def widen_spans(state: GaussianState, row: int, heard: Array) -> Array:
    """Spans (L, 2) of the walls after the bounces that a row heard.

    Parameters
    ----------
    state : GaussianState
        State with corrected rows.
    row : int
        The row to believe.
    heard : ndarray, shape (K, F)
        Probability that each feature was measured.
    """
    layout, mean = state.layout, state.rows.mean[row]
    span = state.slots.span_m.copy()
    if not layout.shared:
        return span
    wall = mean[layout.walls].reshape(-1, 2)
    normal = wall / np.linalg.norm(wall, axis=1, keepdims=True)
    for k in range(layout.anchors):
        image = reflect(mean[None, layout.anchor(k)][:, :2], wall)
        side, other = wall_side(mean[None, :2], wall), wall_side(image, wall)
        gap = np.where(side == other, 1.0, side - other)
        bounce = mean[:2] + (side / gap)[:, None] * (image - mean[:2])
        along = bounce[:, 1] * normal[:, 0] - bounce[:, 0] * normal[:, 1]
        hit = heard[k, 1 : 1 + layout.slots] > 0.5
        span[:, 0] = np.where(hit, np.minimum(span[:, 0], along), span[:, 0])
        span[:, 1] = np.where(hit, np.maximum(span[:, 1], along), span[:, 1])
    return span


def remember(
    state: GaussianState, paths: PathTable, explained: Array, config: GaussianConfig
) -> GaussianState:
    """Note where the agent is and what nothing explains.

    A path counts as explained if a feature probably gave it, or if it lies close to
    where any possible feature would be heard: beside a known path stand its echoes,
    not new walls. Of an anchor that hears hundreds of paths nothing is noted: in a flood every
    wall could be found, and searching it takes minutes.

    Parameters
    ----------
    state : GaussianState
        State with corrected rows.
    paths : PathTable
        The epoch's paths.
    explained : ndarray, shape (K, M)
        Probability that the best row explains each path.
    config : GaussianConfig
        ``pair_radius_m`` and the windows.
    """
    rows, best = state.rows, state.rows.best
    mean, covariance = rows.mean[best], rows.covariance[best]
    std = np.sqrt(0.5 * np.trace(covariance[:2, :2]))
    trail = np.concatenate([state.trail, [[state.epoch, mean[0], mean[1], std]]])
    prediction = predict_paths(mean[None], state.layout)
    spread = predicted_variance(prediction, covariance[None])[0]
    distance = np.abs(paths.length_m[:, None, :] - prediction.length_m[0][..., None])
    beside = config.pair_radius_m if state.shared else 2.0 * config.range_std_m
    radius = np.minimum(beside + 2.0 * np.sqrt(spread), 3.0)
    active = state.active()[best] & prediction.possible[0]
    near = np.any(active[..., None] & (distance < radius[..., None]), axis=1)
    taken = rows.located[best][:, None] & (near | (explained > 0.3))
    flood = np.sum(paths.valid, axis=1) > _FLOOD
    k, j = np.nonzero(paths.valid & ~flood[:, None])
    columns = (paths.length_m[k, j], paths.std_m[k, j], paths.excess_loss_db[k, j], ~taken[k, j])
    heard = np.concatenate([state.heard, np.stack([np.full(k.size, state.epoch), k, *columns], axis=1)])
    window = config.birth_window if state.shared else config.virtual_window
    oldest = state.epoch - max(window, config.start_window)
    return replace(state, trail=trail[trail[:, 0] > oldest], heard=heard[heard[:, 0] > oldest])
