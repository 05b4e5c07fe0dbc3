"""Circles and paths as seen from places where an anchor may stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.circles import Centres
from estimator.slam.config import GaussianConfig
from estimator.slam.features import wall_side

__all__ = ["Heard", "PathBatch", "Seen", "prior_visibility", "see", "walls_between"]

Array = NDArray[np.float64]
_PRIOR = (0.9, 0.6, 0.2)  # that a path of 0, 1, 2 bounces can be heard
_LOSS_MEAN_DB, _LOSS_STD_DB, _LOSS_RANGE_DB = 0.0, 2.5, 40.0  # direct paths; any path


@dataclass(frozen=True, eq=False)
class PathBatch:
    """Path lengths of one anchor.

    Parameters
    ----------
    length_m, variance_m2 : ndarray, shape (N,)
        Lengths and their variances.
    epoch : ndarray of int64, shape (N,)
        The epoch each belongs to.
    excess_loss_db : ndarray, shape (N,)
        Loss beyond free space, dB; NaN if unknown.
    """

    length_m: Array
    variance_m2: Array
    epoch: NDArray[np.int64]
    excess_loss_db: Array


@dataclass(frozen=True, eq=False)
class Heard:
    """Circles and paths epoch by epoch: those of different epochs never meet.

    Parameters
    ----------
    x, y : ndarray, shape (E, Q)
        Centres.
    xx, xy, yy : ndarray, shape (E, Q)
        Their covariances.
    bounces, wall : ndarray of int64, shape (Q,)
        Of the centres, alike in all epochs.
    length_m, variance_m2 : ndarray, shape (E, 1, M)
        Path lengths; infinity where there is none.
    clutter : ndarray, shape (E, Q, M)
        Intensity of clutter in units of the density of the path's loss.
    """

    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array
    bounces: NDArray[np.int64]
    wall: NDArray[np.int64]
    length_m: Array
    variance_m2: Array
    clutter: Array

    @classmethod
    def of(cls, centres: Centres, paths: PathBatch, config: GaussianConfig) -> Heard:
        """The circles and paths of a search."""
        epochs = np.unique(centres.epoch)
        centre = np.argsort(centres.epoch, kind="stable").reshape(epochs.size, -1)
        own = [np.flatnonzero(paths.epoch == epoch) for epoch in epochs]
        path = np.zeros((epochs.size, max(each.size for each in own)), dtype=np.int64)
        length = np.full(path.shape, np.inf)
        for e, each in enumerate(own):
            path[e, : each.size] = each
            length[e, : each.size] = paths.length_m[each]
        x, y = np.moveaxis(centres.point_m[centre], -1, 0)
        spread = centres.covariance_m2[centre]
        bounces = centres.bounces[centre[0]]
        ratio = _loss_ratio(paths, bounces)[:, path].swapaxes(0, 1)
        return cls(
            x,
            y,
            spread[..., 0, 0],
            spread[..., 0, 1],
            spread[..., 1, 1],
            bounces,
            centres.wall[centre[0]],
            length[:, None],
            paths.variance_m2[path][:, None],
            config.clutter_density / ratio,
        )


def _loss_ratio(paths: PathBatch, bounces: NDArray[np.int64]) -> Array:
    """Likelihood ratio (C, N) of each path's loss, centre against clutter; 1 where unknown."""
    deviation = (paths.excess_loss_db - _LOSS_MEAN_DB) / _LOSS_STD_DB
    density = np.exp(-0.5 * deviation**2) / (np.sqrt(2.0 * np.pi) * _LOSS_STD_DB)
    ratio = np.maximum(density * _LOSS_RANGE_DB, 1e-3)
    known = np.isfinite(paths.excess_loss_db)
    return np.where((bounces == 0)[:, None] & known, np.where(known, ratio, 1.0), 1.0)


@dataclass(frozen=True, eq=False)
class Seen:
    """The circles and paths seen from points.

    Parameters
    ----------
    relative : ndarray, shape (S, E, Q, M)
        Likelihoods over clutter's.
    residual : ndarray, shape (S, E, Q, M)
        Path lengths beyond those expected, metres.
    along, across : ndarray, shape (S, E, Q)
        Unit vectors from the centres.
    variance : ndarray, shape (S, E, Q)
        Variance of the centres in their directions.
    """

    relative: Array
    residual: Array
    along: Array
    across: Array
    variance: Array


def see(points: Array, bias: Array, heard: Heard, config: GaussianConfig) -> Seen:
    """What was heard, from points (S, 2) with clock biases (S,)."""
    along = points[:, None, None, 0] - heard.x
    across = points[:, None, None, 1] - heard.y
    distance = np.maximum(np.sqrt(along * along + across * across), 1e-6)
    along, across = along / distance, across / distance
    spread = along * (along * heard.xx + 2.0 * across * heard.xy) + across * across * heard.yy
    residual = heard.length_m - (bias[:, None, None] + distance)[..., None]
    variance = spread[..., None] + heard.variance_m2
    square = residual * residual / variance
    relative, near = np.zeros(square.shape), np.nonzero(square < config.gate_sigma**2)
    clutter = np.broadcast_to(heard.clutter, square.shape)[near]
    relative[near] = np.exp(-0.5 * square[near]) / (np.sqrt(2.0 * np.pi * variance[near]) * clutter)
    return Seen(relative, residual, along, across, spread)


def prior_visibility(points: Array, heard: Heard, walls: dict[int, Array]) -> Array:
    """Prior visibilities (S, Q)."""
    visible = np.tile(np.array(_PRIOR)[heard.bounces], (len(points), 1))
    if walls:
        slots, vrps = np.array(list(walls)), np.array(list(walls.values()))
        over, wall = np.nonzero((heard.wall[:, None] == slots) & (heard.bounces == 1)[:, None])
        visible[:, over] *= wall_side(points[:, None], vrps)[:, wall] < 0.0
    return visible


def walls_between(points: Array, walls: dict[int, Array]) -> NDArray[np.int64]:
    """Number of known walls behind which points (S, 2) stand."""
    behind = np.zeros(len(points), dtype=np.int64)
    for vrp in walls.values():
        behind += wall_side(points, vrp) > 0.0
    return behind
