"""Probabilistic data association by loopy belief propagation.

Each feature gives at most one measurement, each measurement comes from at most one
feature (equations (28)-(31)). The iteration is that of J. Williams and R. Lau,
"Approximate evaluation of marginal association probabilities with belief
propagation", IEEE Trans. Aerosp. Electron. Syst. 50(4), 2014; the evidence is the
Bethe approximation at its fixed point, exact where the association graph is a tree.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["ITERATIONS", "associate", "associate_all", "associate_pairs"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
ITERATIONS: Final = 12  # rounds of messages at most: loops of two tracks and two paths settle in fewer
_SETTLED: Final = 1e-6  # relative change of messages that is rounding for what follows


@compiled
def associate_pairs(
    odds: Array,
    feature: Index,
    measurement: Index,
    forth: Array,
    back: Array,
    by_feature: Array,
    by_measurement: Array,
    iterations: int = ITERATIONS,
) -> None:
    """Messages between features and measurements of which only N pairs are possible.

    Time is that of the pairs, times the iterations.

    Parameters
    ----------
    odds : ndarray, shape (N,)
        Likelihood of "feature gave measurement" over "feature was missed and measurement is clutter".
    feature, measurement : ndarray of int64, shape (N,)
        Which pair it is.
    forth, back : ndarray, shape (N,)
        Take the messages from features to measurements and back; a pair has the probability
        ``odds * back / (1 + by_feature[feature])``.
    by_feature, by_measurement : ndarray, shapes (F,), (M,)
        Take the sums of ``odds * back`` of each feature, and of ``forth`` of each measurement.
    iterations : int
        Rounds of message passing, at least 1; fewer where the messages have settled.
    """
    back[:] = 1.0
    for _ in range(iterations):
        by_feature[:] = 0.0
        by_measurement[:] = 0.0
        for e in range(len(odds)):
            by_feature[feature[e]] += odds[e] * back[e]
        for e in range(len(odds)):
            forth[e] = odds[e] / (1.0 + by_feature[feature[e]] - odds[e] * back[e])
            by_measurement[measurement[e]] += forth[e]
        moving = False
        for e in range(len(odds)):
            before = back[e]
            back[e] = 1.0 / (1.0 + by_measurement[measurement[e]] - forth[e])
            if abs(back[e] - before) > _SETTLED * before:
                moving = True
        if not moving:
            break
    by_feature[:] = 0.0
    for e in range(len(odds)):
        by_feature[feature[e]] += odds[e] * back[e]


@compiled
def associate(ratio: Array, probability: Array, message: Array, iterations: int = ITERATIONS) -> float:
    """Marginals of a one-to-one association; the log of its evidence.

    Time is that of the pairs that are not forbidden, times the iterations.

    Parameters
    ----------
    ratio : ndarray, shape (F, M)
        Likelihood of "feature f gave measurement j" over "feature f was missed and
        measurement j is clutter"; 0 forbids a pair.
    probability : ndarray, shape (F, M)
        Takes the probability that feature ``f`` gave measurement ``j``.
    message : ndarray, shape (F, M)
        Takes what measurement ``j`` tells feature ``f``: from 1, the pair is uncontested, to
        0, others claim the measurement.
    iterations : int
        Rounds of message passing, at least 1; fewer where the messages have settled.

    Returns
    -------
    float
        Log of the sum over all associations of the product of their ratios (Bethe approximation).
    """
    features, measurements = ratio.shape
    count = 0
    for f in range(features):
        for j in range(measurements):
            probability[f, j], message[f, j] = 0.0, 1.0
            if ratio[f, j] > 0.0:
                count += 1
    if count == 0:
        return 0.0
    row, column = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    odds, forth, back = np.empty(count), np.empty(count), np.empty(count)
    e = 0
    for f in range(features):
        for j in range(measurements):
            if ratio[f, j] > 0.0:
                row[e], column[e], odds[e] = f, j, ratio[f, j]
                e += 1
    by_feature, by_measurement = np.empty(features), np.empty(measurements)
    associate_pairs(odds, row, column, forth, back, by_feature, by_measurement, iterations)
    evidence = 0.0
    for f in range(features):
        evidence += np.log1p(by_feature[f])
    for j in range(measurements):
        evidence += np.log1p(by_measurement[j])
        for f in range(features):
            message[f, j] = 1.0 / (1.0 + by_measurement[j])
    for e in range(count):
        evidence -= np.log1p(forth[e] * back[e])
        probability[row[e], column[e]] = odds[e] * back[e] / (1.0 + by_feature[row[e]])
        message[row[e], column[e]] = back[e]
    return evidence


@compiled
def associate_all(ratio: Array, iterations: int = ITERATIONS) -> tuple[Array, Array, Array]:
    """:func:`associate` of N independent graphs (N, F, M): probabilities, messages and log evidences (N,)."""
    probability, message = np.empty(ratio.shape), np.empty(ratio.shape)
    evidence = np.empty(ratio.shape[0])
    for i in range(ratio.shape[0]):
        evidence[i] = associate(ratio[i], probability[i], message[i], iterations)
    return probability, message, evidence
