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
from estimator.slam.config import GaussianConfig
from estimator.slam.features import Prediction, predict_paths
from estimator.slam.layout import Layout

__all__ = ["Correction", "correct", "kalman", "predicted_variance"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Correction:
    """What an epoch does to the rows.

    Parameters
    ----------
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

    mean: Array
    covariance: Array
    visibility: Array
    heard: Array
    explained: Array
    log_evidence: Array


def kalman(
    mean: Array, covariance: Array, jacobian: Array, innovation: Array, variance: Array
) -> tuple[Array, Array, Array]:
    """Joint Kalman update of rows; also the log density of the innovations.

    Shapes: mean (R, n), covariance (R, n, n), jacobian (R, m, n), innovation and
    variance (R, m). A measurement a row does not use has a zero jacobian row and
    innovation and a variance of ``1 / (2 pi)``, so that it adds nothing at all.
    """
    cross = jacobian @ covariance  # (R, m, n)
    size = innovation.shape[1]
    s = cross @ jacobian.transpose(0, 2, 1)
    s[:, np.arange(size), np.arange(size)] += variance
    right = np.concatenate([cross, innovation[..., None]], axis=2)
    solved = np.linalg.solve(s, right)
    mean = mean + np.einsum("rmn,rm->rn", cross, solved[..., -1])
    covariance = covariance - cross.transpose(0, 2, 1) @ solved[..., :-1]
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    _, log_determinant = np.linalg.slogdet(s)
    distance = np.sum(innovation * solved[..., -1], axis=1)
    return mean, covariance, -0.5 * (log_determinant + distance + size * _LOG_2PI)


def _take(
    mean: Array, covariance: Array, jacobian: Array, innovation: Array, variance: Array, use: Mask
) -> tuple[Array, Array, Array]:
    """:func:`kalman` with the features (R, K, F) that ``use`` marks."""
    rows, size = mean.shape
    columns = np.flatnonzero(use.reshape(rows, -1).any(axis=0))
    if columns.size == 0:
        return mean, covariance, np.zeros(rows)
    keep = use.reshape(rows, -1)[:, columns]
    return kalman(
        mean,
        covariance,
        np.where(keep[..., None], jacobian.reshape(rows, -1, size)[:, columns], 0.0),
        np.where(keep, innovation.reshape(rows, -1)[:, columns], 0.0),
        np.where(keep, variance.reshape(rows, -1)[:, columns], 0.5 / np.pi),
    )


def correct(
    mean: Array,
    covariance: Array,
    visibility: Array,
    active: Mask,
    length_m: Array,
    std_m: Array,
    valid: Mask,
    layout: Layout,
    config: GaussianConfig,
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
    length_m, std_m : ndarray, shape (K, M)
        Measured path lengths and their standard deviations, metres.
    valid : ndarray of bool, shape (K, M)
        Which of them are measurements.
    layout : Layout
        Positions in the state vector.
    config : GaussianConfig
        Models.

    Returns
    -------
    Correction
    """
    variance = np.maximum(std_m, config.range_std_m) ** 2
    prediction = predict_paths(mean, layout)
    active = active & prediction.possible
    chance = np.where(active, visibility * config.detection_probability, 0.0)
    ratio, _, innovation = _ratios(prediction, covariance, chance, length_m, variance, valid, layout, config)

    # first pass: one measurement in the gate, in no other gate, and far likelier than chance
    near = ratio > 0.0
    alone = near & (near.sum(axis=-1, keepdims=True) == 1) & (near.sum(axis=-2, keepdims=True) == 1)
    sure = alone & (ratio > 20.0)
    taken = sure.any(axis=-1)  # (R, K, F)
    chosen = np.argmax(sure, axis=-1)
    first = np.take_along_axis(innovation, chosen[..., None], axis=-1)[..., 0]
    noise = variance[np.arange(layout.anchors)[None, :, None], chosen]
    prior = np.log(np.maximum(chance, 1e-12) / config.clutter_density)
    log_evidence = np.sum(np.where(taken, prior, 0.0), axis=(1, 2))
    mean, covariance, log_density = _take(mean, covariance, prediction.jacobian, first, noise, taken)
    log_evidence = log_evidence + log_density
    used = sure.any(axis=-2)  # (R, K, M)

    # second pass: everything else, predicted again
    prediction = predict_paths(mean, layout)
    rest = np.where(taken, 0.0, chance)
    ratio, spread, innovation = _ratios(
        prediction, covariance, rest, length_m, variance, valid, layout, config
    )
    ratio = np.where(used[:, :, None, :], 0.0, ratio)
    association = associate(ratio)
    log_evidence = log_evidence + np.sum(association.log_evidence + np.sum(np.log1p(-rest), axis=-1), axis=-1)
    share = association.probability  # (R, K, F, M)
    heard = share.sum(axis=-1)
    weight = np.maximum(heard, 1e-12)
    expected = np.sum(share * innovation, axis=-1) / weight
    second = np.sum(share * (innovation**2 + variance[:, None, :]), axis=-1) / weight - expected**2
    soft = (heard > 0.05) & (spread < config.pair_std_m**2)
    mean, covariance, _ = _take(mean, covariance, prediction.jacobian, expected, second / weight, soft)

    heard = np.where(taken, 1.0, heard)
    seen = (
        visibility * (1.0 - config.detection_probability) / (1.0 - visibility * config.detection_probability)
    )
    visibility = np.where(active, heard + (1.0 - heard) * seen, visibility)
    explained = np.where(used, 1.0, share.sum(axis=-2))
    return Correction(mean, covariance, visibility, heard, explained, log_evidence)


def _ratios(
    prediction: Prediction,
    covariance: Array,
    chance: Array,
    length_m: Array,
    variance: Array,
    valid: Mask,
    layout: Layout,
    config: GaussianConfig,
) -> tuple[Array, Array, Array]:
    """Association ratios and innovations (R, K, F, M), and predicted variances (R, K, F)."""
    spread = predicted_variance(prediction, covariance)
    s = spread[..., None] + variance[:, None, :]
    innovation = length_m[:, None, :] - prediction.length_m[..., None]
    distance = innovation**2 / s
    known = np.ones(spread.shape, dtype=bool)
    known[..., 1 + layout.slots :] = spread[..., 1 + layout.slots :] < config.pair_gate_std_m**2
    gated = valid[:, None, :] & (distance < config.gate_sigma**2) & ((chance > 0.0) & known)[..., None]
    density = np.exp(-0.5 * distance) / np.sqrt(2.0 * np.pi * s)
    odds = chance / ((1.0 - chance) * config.clutter_density)
    return np.where(gated, odds[..., None] * density, 0.0), spread, innovation


def predicted_variance(prediction: Prediction, covariance: Array) -> Array:
    """Variance (R, K, F) of the predicted lengths that is due to the state."""
    rows, anchors, features, size = prediction.jacobian.shape
    flat = prediction.jacobian.reshape(rows, anchors * features, size)
    return np.asarray(np.sum((flat @ covariance) * flat, axis=-1).reshape(rows, anchors, features))
