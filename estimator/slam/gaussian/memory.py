"""What an epoch leaves behind for later steps: the track, the unexplained, the spans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import plane, predict_paths
from estimator.slam.gaussian.packing import packed
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.pool import Pool, active_of
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.layout import Layout

__all__ = ["clutter_density", "heard_of", "remember", "widen_spans", "widen_stretches"]

Array = NDArray[np.float64]

_UNKNOWN_PATHS = 6.0  # expected of an anchor beyond clutter, before any wall is known
_PRIOR_EPOCHS = 4.0  # that this expectation weighs
_FARTHEST_M = 3.0  # beside a feature, however badly it is known


def clutter_density(states: Sequence[GaussianState], config: GaussianConfig) -> Array:
    """Intensity (B, K) per metre of paths that no known feature gives: clutter, and walls not yet found.

    Recent epochs of each of the runs (of K anchors) tell how many there are. With no wall on the map,
    most paths are such; they must not be taken for the line of sight.
    """
    runs, anchors = len(states), len(states[0].anchor_names)
    blind = np.array([state.blind for state in states])
    epochs = np.array([len(state.trail) for state in states])[:, None]
    heard, run = heard_of(states)
    loose = heard[:, 5] == 1.0
    at = run[loose] * anchors + heard[loose, 1].astype(np.int64)
    counts = np.bincount(at, minlength=runs * anchors).reshape(runs, anchors)
    expected = config.clutter_mean + np.where(blind, _UNKNOWN_PATHS, 0.0)[:, None]
    rate = (counts + _PRIOR_EPOCHS * expected) / (epochs + _PRIOR_EPOCHS)
    return np.asarray(np.maximum(rate, config.clutter_mean) / config.region_m + 1e-12)


def heard_of(states: Sequence[GaussianState]) -> tuple[Array, NDArray[np.int64]]:
    """The remembered paths (N, 6) of all runs, and the run (N,) of each."""
    counts = [len(state.heard) for state in states]
    return np.concatenate([state.heard for state in states]), np.repeat(np.arange(len(states)), counts)


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
    if not layout.shared:
        return span_m
    agent, wall = (
        plane(mean[:, layout.POSITION])[:, None, None],
        plane(mean[:, layout.walls].reshape(len(mean), 1, layout.slots, 2)),
    )
    devices = mean[:, layout.FIRST_ANCHOR : layout.walls.start].reshape(len(mean), layout.anchors, 1, -1)
    size = np.abs(wall)
    towards = (wall / size).conj()
    image = wall - wall / wall.conj() * plane(devices).conj()  # (B, K, L)
    here, there = (agent * towards), (image * towards)  # along the normal, and along the wall
    side, other = here.real - 0.5 * size, there.real - 0.5 * size
    gap = np.where(side == other, 1.0, side - other)
    along = here.imag + side / gap * (there.imag - here.imag)
    hit = heard[:, :, 1 : 1 + layout.slots] > 0.5
    least = np.min(along, axis=1, initial=np.inf, where=hit)
    most = np.max(along, axis=1, initial=-np.inf, where=hit)
    span = np.empty_like(span_m)
    span[..., 0], span[..., 1] = np.minimum(span_m[..., 0], least), np.maximum(span_m[..., 1], most)
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
    run, anchor, wall = np.nonzero(heard[:, :, 1 : 1 + layout.slots] > 0.5)
    places, here = heard_from_m.copy(), mean[run, layout.POSITION]
    first = places[run, wall, anchor, 0]
    places[run, wall, anchor, 0] = np.where(np.isnan(first), here, first)
    places[run, wall, anchor, 1] = here
    return places


def remember(
    states: Sequence[GaussianState], pool: Pool, paths: PathTable, explained: Array, config: GaussianConfig
) -> list[GaussianState]:
    """Note where the agents of runs with one layout are and what nothing explains.

    A path counts as explained if a feature probably gave it, or if it lies close to
    where any possible feature would be heard: beside a known path stand its echoes,
    not new walls.

    Parameters
    ----------
    states : sequence of GaussianState
        States with corrected rows, B runs.
    pool : Pool
        Their rows.
    paths : PathTable
        The epoch's paths (B, K, M).
    explained : ndarray, shape (B, K, M)
        Probability that the best row of each run explains each path.
    config : GaussianConfig
        ``pair_radius_m`` and the windows.
    """
    layout = states[0].layout
    pool = pool.leaders()
    mean, covariance = pool.rows.mean, pool.rows.covariance
    std = np.sqrt(0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]))
    taken = pool.rows.located[..., None] & (explained > 0.3)
    taken |= _beside_known(pool, active_of(pool, states, layout), paths, paths.valid & ~taken, layout, config)
    run, k, _ = at = np.nonzero(paths.valid)
    now = np.array([state.epoch for state in states])
    new = np.empty((run.size, 6))
    new[:, 0], new[:, 1], new[:, 2], new[:, 3] = now[run], k, paths.length_m[at], paths.std_m[at]
    new[:, 4], new[:, 5] = paths.excess_loss_db[at], ~taken[at]
    ends = np.searchsorted(run, np.arange(1, len(states) + 1)).tolist()
    here = np.empty((len(states), 4))
    here[:, 0], here[:, 1:3], here[:, 3] = now, mean[:, layout.POSITION], std
    window = config.birth_window if layout.shared else config.virtual_window
    oldest = (now - max(window, config.start_window)).tolist()
    after = []
    for b, (state, begin, end) in enumerate(zip(states, [0, *ends], ends, strict=False)):
        heard = state.heard[state.heard[:, 0].searchsorted(oldest[b], "right") :]  # in the order of epochs
        trail = state.trail[state.trail[:, 0].searchsorted(oldest[b], "right") :]
        after.append(
            state.but(
                trail=np.concatenate([trail, here[b : b + 1]]), heard=np.concatenate([heard, new[begin:end]])
            )
        )
    return after


def _beside_known(
    pool: Pool,
    active: NDArray[np.bool_],
    paths: PathTable,
    asked: NDArray[np.bool_],
    layout: Layout,
    config: GaussianConfig,
) -> NDArray[np.bool_]:
    """Which of the paths ``asked`` (B, K, M) lie close to where a feature of a run's row could be heard."""
    result = np.zeros(asked.shape, dtype=bool)
    run, anchor, path = np.nonzero(asked)
    if run.size == 0:
        return result
    prediction = predict_paths(pool.rows.mean, layout)
    beside = config.pair_radius_m if layout.shared else 2.0 * config.range_std_m
    gap = np.abs(paths.length_m[run, anchor, path, None] - prediction.length_m[run, anchor])  # (N, F)
    may = (gap < _FARTHEST_M) & (active & prediction.possible)[run, anchor]
    sure = np.asarray((may & (gap < beside)).any(axis=-1))
    which, feature = np.nonzero(may & ~sure[:, None])
    if which.size:  # near it perhaps, given how badly some features are known
        doubt = np.zeros(active.shape, dtype=bool)
        doubt[run[which], anchor[which], feature] = True
        column, real = packed(doubt)
        jacobian = prediction.derivatives(column).reshape(len(column), -1, layout.size)
        spread = np.einsum("bin,bin->bi", jacobian @ pool.rows.covariance, jacobian).reshape(column.shape)
        radius = np.zeros(active.shape)
        at = np.nonzero(real)
        radius[at[0], at[1], column[at]] = np.minimum(beside + 2.0 * np.sqrt(spread[at]), _FARTHEST_M)
        close = gap[which, feature] < radius[run[which], anchor[which], feature]
        sure[which[close]] = True
    result[run, anchor, path] = sure
    return result
