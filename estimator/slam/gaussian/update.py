"""One epoch of path lengths into the hypotheses: associate, weigh, correct.

Two passes. Pairs of feature and measurement that are beyond doubt are taken first,
all at once and with the joint density of their innovations; what is left is
predicted again and settled (:mod:`estimator.slam.gaussian.doubts`).
Where two paths cross, the second pass is much surer than the first would be; that the two are exchanged
is weighed exactly (:mod:`estimator.slam.gaussian.swaps`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.association import associate
from estimator.slam.config import GaussianConfig
from estimator.slam.features import predict_paths
from estimator.slam.gaussian.azimuths import take_azimuths
from estimator.slam.gaussian.doubts import Doubts, settle
from estimator.slam.gaussian.hearing import Hearing, take
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.swaps import exchange_odds
from estimator.slam.gaussian.turning import turned
from estimator.slam.layout import Layout

__all__ = ["Correction", "correct"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_SURE, _EXCHANGED = 0.998, 0.002  # association probability beyond doubt; odds of an exchange in doubt
_LIKELY_NATS = 5.0  # from the best row of its run


@dataclass(frozen=True, eq=False)
class Correction:
    """What an epoch does to the rows.

    Parameters
    ----------
    parent : ndarray of int64, shape (R,)
        The row of the input that each row of the output comes from.
    mean, covariance : ndarray, shapes (R, n) and (R, n, n)
        Corrected Gaussians.
    visibility : ndarray, shape (R, K, F)
        Updated visibility.
    heard : ndarray, shape (R, K, F)
        Probability that the feature was measured.
    explained : ndarray, shape (R, K, M)
        Probability that a measurement comes from a feature.
    log_evidence : ndarray, shape (R,)
        Log evidence of the epoch over "all is clutter".
    """

    parent: NDArray[np.int64]
    mean: Array
    covariance: Array
    visibility: Array
    heard: Array
    explained: Array
    log_evidence: Array


def correct(
    mean: Array,
    covariance: Array,
    visibility: Array,
    active: Mask,
    paths: PathTable,
    layout: Layout,
    config: GaussianConfig,
    clutter: Array | float | None = None,
    run: NDArray[np.int64] | None = None,
    log_weight: Array | None = None,
) -> Correction:
    """Take one epoch of path lengths into all rows.

    Parameters
    ----------
    mean, covariance : ndarray, shapes (R, n) and (R, n, n)
        Predicted Gaussians.
    visibility : ndarray, shape (R, K, F)
        Prior probability that a feature can be heard.
    active : ndarray of bool, shape (R, K, F)
        Features the row has (anchor located, walls present).
    paths : PathTable
        The epoch's paths (K, M), or those of each row (R, K, M); azimuths in the gauge frame.
    layout : Layout
        Positions in the state vector.
    config : GaussianConfig
        Models.
    clutter : ndarray, shape (K,) or (R, K), optional
        Intensity per metre of paths that no feature gives; by default the configuration's.
    run : ndarray of int64, shape (R,), optional
        The run that each row belongs to; by default all are one run's.
    log_weight : ndarray, shape (R,), optional
        Log weights of the rows of each run; by default all are alike.

    Returns
    -------
    Correction
    """
    before = mean
    epoch = Hearing.of(paths, clutter, len(mean), layout, config)
    run = np.zeros(len(mean), dtype=np.int64) if run is None else run
    prediction = predict_paths(mean, layout)
    active = active & prediction.possible
    chance = np.where(active, visibility * config.detection_probability, 0.0)
    free = np.broadcast_to(epoch.paths.valid, (len(mean), *epoch.paths.valid.shape[1:]))

    # first pass: what belief propagation does not doubt
    near = epoch.near(
        mean, covariance, prediction, chance, epoch.beside(prediction.length_m, chance, free), free
    )
    row, anchor, _ = near.at
    sure: Mask = np.asarray(associate(near.ratio).probability > _SURE, dtype=bool)
    label = np.where(sure.any(axis=-1), sure.argmax(axis=-1), -1)
    taken: Mask = np.asarray((label >= 0) & (exchange_odds(near.ratio, label) < _EXCHANGED).all(axis=-1))
    label = np.where(taken, label, -1)  # (R, K, C)
    used: Mask = np.asarray((sure & taken[..., None]).any(axis=-2))  # (R, K, M)
    first = near.innovation[row, anchor, np.arange(label.shape[-1]), label]
    noise = np.broadcast_to(epoch.variance, free.shape)[row, anchor, label]
    own = chance[near.at]
    prior = np.log(np.maximum(own, 1e-12) / epoch.clutter)
    mean, covariance, log_density = take(mean, covariance, near, first, noise, taken)
    heard = np.zeros(chance.shape)
    heard[(*np.nonzero(taken)[:2], near.feature[taken])] = 1.0
    silence = np.log1p(-chance, where=(chance > 0.0) & (heard == 0.0), out=np.zeros(chance.shape))
    log_evidence = log_density + np.where(taken, prior, 0.0).sum(axis=(1, 2)) + silence.sum(axis=(1, 2))

    # second pass: everything else, predicted again, where a measurement might fit a feature
    free = free & ~used
    left = epoch.fitting(near, free, mean - before) & ~taken
    torn = np.asarray(left.any(axis=(1, 2)))
    doubt = torn.nonzero()[0]
    parent, explained = np.arange(len(mean)), used.astype(np.float64)
    if doubt.size:
        could = np.zeros(chance.shape, dtype=bool)
        could[(*np.nonzero(left)[:2], near.feature[left])] = True
        weight = log_evidence if log_weight is None else log_weight + log_evidence
        best = np.full(run.max() + 1, -np.inf)
        np.maximum.at(best, run, weight)
        done = settle(
            Doubts(
                np.arange(doubt.size),
                run[doubt],
                weight[doubt] > best[run[doubt]] - _LIKELY_NATS,
                mean[doubt],
                covariance[doubt],
                chance[doubt],
                could[doubt],
                free[doubt],
                np.zeros((doubt.size, *chance.shape[1:])),
                np.zeros((doubt.size, *free.shape[1:])),
                np.zeros(doubt.size),
            ),
            epoch.of_rows(doubt),
            np.bincount(run),
        )
        count = np.ones(len(mean), dtype=np.int64)
        count[doubt] = np.bincount(done.parent, minlength=doubt.size)
        parent = np.repeat(parent, count)
        again = torn[parent].nonzero()[0]
        if len(parent) > len(mean):
            before, mean, covariance = before[parent], mean[parent], covariance[parent]
            log_evidence, heard, explained = log_evidence[parent], heard[parent], explained[parent]
            active, visibility = active[parent], visibility[parent]
        elif mean is before:  # nothing was beyond doubt
            mean, covariance = mean.copy(), covariance.copy()
        mean[again], covariance[again] = done.mean, done.covariance
        log_evidence[again] += done.log_evidence
        heard[again] = np.maximum(heard[again], done.heard)
        explained[again] = np.maximum(explained[again], done.explained)

    # directions of the first pass's paths (those of the second only helped to associate)
    paths = epoch.paths.of_rows(parent)
    mean, covariance, log_direction = take_azimuths(
        mean, covariance, near.feature[parent], label[parent], paths, layout
    )
    log_evidence = log_evidence + log_direction
    seen = (
        visibility * (1.0 - config.detection_probability) / (1.0 - visibility * config.detection_probability)
    )
    visibility = np.where(active, heard + (1.0 - heard) * seen, visibility)
    if layout.shared:
        mean, covariance = turned(before, mean, covariance, active[:, :, 0], layout)
    return Correction(parent, mean, covariance, visibility, heard, explained, log_evidence)
