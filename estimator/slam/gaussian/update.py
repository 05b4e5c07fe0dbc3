"""One epoch of path lengths into the hypotheses: associate, weigh, correct.

Two passes. Pairs of feature and measurement that are beyond doubt are taken first,
all at once and with the joint density of their innovations; what is left is
predicted again, associated by belief propagation and taken with its probabilities.
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
from estimator.slam.gaussian.hearing import Hearing, Near
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.packing import packed
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.gaussian.swaps import exchange_odds, with_exchange
from estimator.slam.gaussian.turning import turned
from estimator.slam.layout import Layout

__all__ = ["Correction", "correct"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_SURE = 0.998  # association probability beyond doubt
_APART = 0.5  # a row splits if the alternatives move it by more than this many standard deviations
_SPLITS = 3  # doubts of one epoch that a row splits for,
_FEW_ROWS = 64  # or one if there are more rows than these
_LEAST_CHANCE = 1e-3  # of an alternative worth a row,
_MOST_CHANCES = 30  # of which a doubt has at most so many
_CERTAIN = 1e12


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


def _take(
    mean: Array, covariance: Array, near: Near, innovation: Array, variance: Array, use: Mask
) -> tuple[Array, Array, Array]:
    """:func:`kalman` with the features (R, K, C) that ``use`` marks, of the rows that have any."""
    rows, size = mean.shape
    column, keep = packed(use.reshape(rows, -1))
    some = np.flatnonzero(keep.any(axis=1))
    log_density = np.zeros(rows)
    if some.size == 0:
        return mean, covariance, log_density
    row, column, keep = some[:, None], column[some], keep[some]
    mean, covariance = mean.copy(), covariance.copy()
    jacobian, cross = (each.reshape(rows, -1, size)[row, column] for each in (near.jacobian, near.cross))
    jacobian[~keep] = cross[~keep] = 0.0
    mean[some], covariance[some], log_density[some] = kalman(
        mean[some],
        covariance[some],
        jacobian,
        np.where(keep, innovation.reshape(rows, -1)[row, column], 0.0),
        np.where(keep, variance.reshape(rows, -1)[row, column], 0.5 / np.pi),
        cross=cross,
    )
    return mean, covariance, log_density


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
    sure: Mask = np.asarray(associate(near.ratio).probability > _SURE, dtype=bool)
    label = np.where(np.any(sure, axis=-1), np.argmax(sure, axis=-1), -1)
    taken: Mask = np.asarray((label >= 0) & np.all(exchange_odds(near.ratio, label) < 1.0 - _SURE, axis=-1))
    label = np.where(taken, label, -1)  # (R, K, C)
    used: Mask = np.asarray(np.any(sure & taken[..., None], axis=-2))  # (R, K, M)
    first = np.take_along_axis(near.innovation, label[..., None], axis=-1)[..., 0]
    noise = np.take_along_axis(epoch.variance[:, :, None, :], label[..., None], axis=-1)[..., 0]
    own = np.take_along_axis(chance, near.feature, axis=2)
    prior = np.log(np.maximum(own, 1e-12) / epoch.clutter)
    log_evidence = np.sum(np.where(taken, prior, 0.0), axis=(1, 2))
    mean, covariance, log_density = _take(mean, covariance, near, first, noise, taken)
    heard = np.zeros(chance.shape)
    heard[(*np.nonzero(taken)[:2], near.feature[taken])] = 1.0
    log_evidence = (
        log_evidence + log_density + np.sum(np.log1p(-np.where(heard > 0.0, 0.0, chance)), axis=(1, 2))
    )

    # second pass: everything else, predicted again, where a measurement might fit a feature
    free = free & ~used
    left = epoch.fitting(near, free) & ~taken
    doubt = np.flatnonzero(left.any(axis=(1, 2)))
    parent, explained = np.arange(len(mean)), used.astype(np.float64)
    if doubt.size:
        could = np.zeros(chance.shape, dtype=bool)
        could[(*np.nonzero(left)[:2], near.feature[left])] = True
        rows = (mean[doubt], covariance[doubt], chance[doubt], could[doubt], free[doubt])
        done = _second_pass(*rows, epoch.of_rows(doubt), run[doubt], run)
        count = np.ones(len(mean), dtype=np.int64)
        count[doubt] = np.bincount(done.parent, minlength=doubt.size)
        parent = np.repeat(parent, count)
        again = np.flatnonzero(np.isin(parent, doubt))
        mean, covariance, log_evidence = mean[parent], covariance[parent], log_evidence[parent]
        heard, explained = heard[parent], explained[parent]
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
    active, visibility = active[parent], visibility[parent]
    seen = (
        visibility * (1.0 - config.detection_probability) / (1.0 - visibility * config.detection_probability)
    )
    visibility = np.where(active, heard + (1.0 - heard) * seen, visibility)
    if layout.shared:
        mean, covariance = turned(before[parent], mean, covariance, active[:, :, 0], layout)
    return Correction(parent, mean, covariance, visibility, heard, explained, log_evidence)


@dataclass(frozen=True, eq=False)
class _Doubts:
    """What the doubts of an epoch add: the fields of :class:`Correction`, of rows (S,) with a doubt."""

    parent: NDArray[np.int64]
    mean: Array
    covariance: Array
    heard: Array
    explained: Array
    log_evidence: Array


def _second_pass(
    mean: Array,
    covariance: Array,
    chance: Array,
    could: Mask,
    free: Mask,
    epoch: Hearing,
    run: NDArray[np.int64],
    runs: NDArray[np.int64],
) -> _Doubts:
    """Measurements ``free`` (S, K, M) and the features ``could`` (S, K, F) by their probabilities.

    ``run`` (S,) and ``runs`` (R,) are the runs of these rows and of all.
    """
    layout, config = epoch.layout, epoch.config
    prediction = predict_paths(mean, layout)
    near = epoch.near(mean, covariance, prediction, chance, could, free)
    association = associate(near.ratio)
    log_evidence, decisions = np.sum(association.log_evidence, axis=-1), np.zeros(len(mean))
    share = with_exchange(association.probability, near.ratio)  # (S, K, C, M)
    parent = np.arange(len(mean))
    size = np.bincount(runs, minlength=1)
    for turn in range(_SPLITS):
        may = np.asarray((size[run] <= _FEW_ROWS) | (turn == 0))
        split, new, decided, log_ratio = _split(
            share, near.ratio, near.innovation, near.spread, epoch.variance, may
        )
        if not new.size:
            break
        size = size + np.bincount(run[split], minlength=len(size)) - np.bincount(run, minlength=len(size))
        mean, covariance, log_evidence = mean[split], covariance[split], log_evidence[split]
        near, epoch, run, parent = near.of_rows(split), epoch.of_rows(split), run[split], parent[split]
        share, decisions = share[split], decisions[split] + log_ratio
        association = associate(decided)
        near.ratio[new], share[new] = decided, with_exchange(association.probability, decided)
        log_evidence[new] = np.sum(association.log_evidence, axis=-1)
    log_evidence = log_evidence + decisions
    heard = share.sum(axis=-1)
    weight = np.maximum(heard, 1e-12)
    expected = np.sum(share * near.innovation, axis=-1) / weight
    second = (
        np.sum(share * (near.innovation**2 + epoch.variance[:, :, None, :]), axis=-1) / weight - expected**2
    )
    soft = heard > 0.05
    if layout.pairs:
        soft &= (near.feature <= layout.slots) | (near.spread < config.pair_std_m**2)
    mean, covariance, _ = _take(mean, covariance, near, expected, second / weight, soft)
    everywhere = np.zeros((len(mean), *chance.shape[1:]))
    everywhere[(*np.nonzero(near.real)[:2], near.feature[near.real])] = heard[near.real]
    return _Doubts(parent, mean, covariance, everywhere, share.sum(axis=-2), log_evidence)


def _split(
    share: Array, ratio: Array, innovation: Array, spread: Array, variance: Array, may: Mask
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:
    """Split rows by their most harmful doubt if it would blur them, one feature each.

    A feature whose alternatives (its measurements, or none) would move the state far
    apart, against the uncertainty that each would leave, is decided both ways: one row
    per alternative, in which the others are forbidden. Only rows that ``may`` (R,) split do.

    Returns
    -------
    parent : ndarray of int64, shape (S,)
        Row that each new row comes from.
    new : ndarray of int64, shape (D,)
        The new rows in which something was decided.
    decided : ndarray, shape (D, K, F, M)
        Their association ratios.
    log_ratio : ndarray, shape (S,)
        Log ratio of what was decided, over what it stands for in ``decided``.
    """
    noise = variance[:, :, None, :]
    s = spread[..., None] + noise
    shift = spread[..., None] / s * innovation
    first = np.sum(share * shift, axis=-1)
    scatter = np.sum(share * shift**2, axis=-1) - first**2
    left = np.maximum(np.min(spread[..., None] * noise / s, axis=-1), 1e-8)
    harm = (scatter / left).reshape(len(share), -1)
    worst = np.argmax(harm, axis=1)
    torn = np.flatnonzero(may & (harm.max(axis=1) >= _APART**2))
    count = np.ones(len(share), dtype=np.int64)
    decided, log_ratio = [np.empty((0, *ratio.shape[1:]))], [np.empty(0)]
    for r in torn.tolist():
        k, f = np.unravel_index(worst[r], spread.shape[1:])
        chances = np.append(share[r, k, f], max(1.0 - share[r, k, f].sum(), 0.0))
        likely = np.sort(np.argsort(-chances, kind="stable")[:_MOST_CHANCES])
        likely = likely[(chances[likely] > _LEAST_CHANCE) | (likely == np.argmax(chances))]
        count[r] = likely.size
        ways = np.repeat(ratio[r][None], likely.size, axis=0)
        ways[:, k, f] = 0.0
        for way, j in zip(ways, likely.tolist(), strict=True):
            if j < share.shape[-1]:
                way[k, :, j] = 0.0
                way[k, f, j] = _CERTAIN
        decided.append(ways)
        given = np.append(ratio[r, k, f] / _CERTAIN, 1.0)[likely]
        log_ratio.append(np.log(given))
    parent = np.repeat(np.arange(len(share)), count)
    new = np.flatnonzero(np.isin(parent, torn))
    ratios = np.zeros(len(parent))
    ratios[new] = np.concatenate(log_ratio)
    return parent, new, np.concatenate(decided), ratios
