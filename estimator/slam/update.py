"""One epoch of path lengths into the hypotheses: associate, weigh, correct.

Two passes. Pairs of feature and measurement that are beyond doubt are taken first,
all at once and with the joint density of their innovations; what is left is
predicted again, associated by belief propagation and taken with its probabilities.
Where two paths cross, the second pass is much surer than the first would be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.association import associate
from estimator.slam.azimuths import azimuth_ratio, take_azimuths
from estimator.slam.config import GaussianConfig
from estimator.slam.features import Prediction, predict_paths
from estimator.slam.kalman import kalman
from estimator.slam.layout import Layout
from estimator.slam.paths import PathTable

__all__ = ["Correction", "correct", "predicted_variance"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_SURE = 0.998  # association probability beyond doubt
_APART = 0.5  # a row splits if the alternatives move it by more than this many standard deviations
_SPLITS = 3  # doubts of one epoch that a row splits for,
_FEW_ROWS = 32  # or one if there are more rows than these
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
    mean: Array, covariance: Array, jacobian: Array, innovation: Array, variance: Array, use: Mask
) -> tuple[Array, Array, Array]:
    """:func:`kalman` with the features (R, K, F) that ``use`` marks, of the rows that have any."""
    rows, size = mean.shape
    use = use.reshape(rows, -1)
    count = use.sum(axis=1)
    some = np.flatnonzero(count)
    log_density = np.zeros(rows)
    if some.size == 0:
        return mean, covariance, log_density
    column = np.argsort(~use[some], axis=1, kind="stable")[:, : count.max()]  # each row's own first
    row = some[:, None]
    keep = use[row, column]
    mean, covariance = mean.copy(), covariance.copy()
    mean[some], covariance[some], log_density[some] = kalman(
        mean[some],
        covariance[some],
        np.where(keep[..., None], jacobian.reshape(rows, -1, size)[row, column], 0.0),
        np.where(keep, innovation.reshape(rows, -1)[row, column], 0.0),
        np.where(keep, variance.reshape(rows, -1)[row, column], 0.5 / np.pi),
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
    paths = paths.by_row()
    clutter = np.asarray(config.clutter_density if clutter is None else clutter)
    clutter = np.broadcast_to(clutter, (len(mean), layout.anchors))[..., None]
    variance = np.maximum(paths.std_m, config.range_std_m) ** 2
    prediction = predict_paths(mean, layout)
    active = active & prediction.possible
    chance = np.where(active, visibility * config.detection_probability, 0.0)
    ratio, _, innovation = _ratios(prediction, covariance, chance, clutter, paths, variance, layout, config)
    ratio = ratio * azimuth_ratio(mean, covariance, paths, layout)

    # first pass: what belief propagation does not doubt
    sure: Mask = np.asarray(associate(ratio).probability > _SURE, dtype=bool)
    taken: Mask = np.asarray(np.any(sure, axis=-1))  # (R, K, F)
    chosen = np.argmax(sure, axis=-1)
    first = np.take_along_axis(innovation, chosen[..., None], axis=-1)[..., 0]
    noise = np.take_along_axis(variance[:, :, None, :], chosen[..., None], axis=-1)[..., 0]
    prior = np.log(np.maximum(chance, 1e-12) / clutter)
    log_evidence = np.sum(np.where(taken, prior, 0.0), axis=(1, 2))
    mean, covariance, log_density = _take(mean, covariance, prediction.jacobian, first, noise, taken)
    log_evidence = log_evidence + log_density
    used: Mask = np.asarray(np.any(sure, axis=-2))  # (R, K, M)

    # second pass: everything else, predicted again
    prediction = predict_paths(mean, layout)
    rest = np.where(taken, 0.0, chance)
    ratio, spread, innovation = _ratios(
        prediction, covariance, rest, clutter, paths, variance, layout, config
    )
    ratio = ratio * azimuth_ratio(mean, covariance, paths, layout)
    ratio = np.where(used[:, :, None, :], 0.0, ratio)
    association = associate(ratio)
    log_evidence = log_evidence + np.sum(association.log_evidence + np.sum(np.log1p(-rest), axis=-1), axis=-1)
    share, jacobian = association.probability, prediction.jacobian  # (R, K, F, M), (R, K, F, n)
    parent = np.arange(len(mean))
    run = np.zeros(len(mean), dtype=np.int64) if run is None else run
    for turn in range(_SPLITS):
        may = np.asarray((np.bincount(run)[run] <= _FEW_ROWS) | (turn == 0))
        split, new, decided, log_share = _split(share, ratio, innovation, spread, variance, may)
        if not new.size:
            break
        mean, covariance, log_evidence = mean[split], covariance[split], log_evidence[split] + log_share
        visibility, active, taken, used = visibility[split], active[split], taken[split], used[split]
        spread, innovation, chosen, jacobian = (
            spread[split],
            innovation[split],
            chosen[split],
            jacobian[split],
        )
        run, parent, ratio, share, paths = (
            run[split],
            parent[split],
            ratio[split],
            share[split],
            paths.of_rows(split),
        )
        variance = variance if len(variance) == 1 else variance[split]
        ratio[new], share[new] = decided, associate(decided).probability
    heard = share.sum(axis=-1)
    weight = np.maximum(heard, 1e-12)
    expected = np.sum(share * innovation, axis=-1) / weight
    second = np.sum(share * (innovation**2 + variance[:, :, None, :]), axis=-1) / weight - expected**2
    soft = heard > 0.05
    soft[..., 1 + layout.slots :] &= spread[..., 1 + layout.slots :] < config.pair_std_m**2
    mean, covariance, _ = _take(mean, covariance, jacobian, expected, second / weight, soft)

    # directions of the first pass's paths (those of the second only helped to associate)
    label = np.where(taken, chosen, -1)
    mean, covariance, log_direction = take_azimuths(mean, covariance, label, paths, layout)
    log_evidence = log_evidence + log_direction

    heard = np.where(taken, 1.0, heard)
    seen = (
        visibility * (1.0 - config.detection_probability) / (1.0 - visibility * config.detection_probability)
    )
    visibility = np.where(active, heard + (1.0 - heard) * seen, visibility)
    explained = np.where(used, 1.0, share.sum(axis=-2))
    return Correction(parent, mean, covariance, visibility, heard, explained, log_evidence)


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
    log_share : ndarray, shape (S,)
        Log probability of the alternative.
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
    decided, log_share = [np.empty((0, *ratio.shape[1:]))], [np.empty(0)]
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
        log_share.append(np.log(chances[likely]))
    parent = np.repeat(np.arange(len(share)), count)
    new = np.flatnonzero(np.isin(parent, torn))
    shares = np.zeros(len(parent))
    shares[new] = np.concatenate(log_share)
    return parent, new, np.concatenate(decided), shares


def _ratios(
    prediction: Prediction,
    covariance: Array,
    chance: Array,
    clutter: Array,
    paths: PathTable,
    variance: Array,
    layout: Layout,
    config: GaussianConfig,
) -> tuple[Array, Array, Array]:
    """Association ratios and innovations (R, K, F, M), and predicted variances (R, K, F)."""
    spread = predicted_variance(prediction, covariance)
    s = spread[..., None] + variance[:, :, None, :]
    innovation = paths.length_m[:, :, None, :] - prediction.length_m[..., None]
    distance = innovation**2 / s
    known = np.ones(spread.shape, dtype=bool)
    known[..., 1 + layout.slots :] = spread[..., 1 + layout.slots :] < config.pair_gate_std_m**2
    gated = (
        paths.valid[:, :, None, :] & (distance < config.gate_sigma**2) & ((chance > 0.0) & known)[..., None]
    )
    ratio = np.zeros(gated.shape)
    near = np.nonzero(gated)
    odds = (chance / ((1.0 - chance) * clutter))[near[:-1]]
    ratio[near] = odds * (np.exp(-0.5 * distance[near]) / np.sqrt(2.0 * np.pi * s[near]))
    return ratio, spread, innovation


def predicted_variance(prediction: Prediction, covariance: Array) -> Array:
    """Variance (R, K, F) of the predicted lengths that is due to the state."""
    rows, anchors, features, size = prediction.jacobian.shape
    flat = prediction.jacobian.reshape(rows, anchors * features, size)
    return np.asarray(np.sum((flat @ covariance) * flat, axis=-1).reshape(rows, anchors, features))
