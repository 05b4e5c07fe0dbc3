"""Kalman updates of one Gaussian by scalar measurements with few non-zero derivatives.

Measurements with independent errors, linearised at one state, may be taken one after the other: the result,
and the product of their densities, are those of the joint update.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["joint_update", "projected", "scalar_update"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def projected(covariance: Array, index: Index, value: Array, entries: int, cross: Array) -> float:
    """Variance of what has the derivatives ``value`` at ``index``; ``cross`` (n,) takes its covariances."""
    cross[:] = 0.0
    for e in range(entries):
        row, factor = covariance[index[e]], value[e]
        for i in range(row.size):
            cross[i] += factor * row[i]
    variance = 0.0
    for e in range(entries):
        variance += value[e] * cross[index[e]]
    return variance


@compiled
def scalar_update(
    mean: Array,
    covariance: Array,
    index: Index,
    value: Array,
    entries: int,
    innovation: float,
    variance: float,
    cross: Array,
) -> float:
    """Correct a Gaussian, in place, by one measurement; the log density of the innovation.

    Parameters
    ----------
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The Gaussian; the covariance stays symmetric to the bit.
    index, value, entries
        The derivatives of the measurement that are not zero.
    innovation, variance : float
        Measured minus predicted, and the variance of the measurement.
    cross : ndarray, shape (n,)
        Work space.
    """
    s = projected(covariance, index, value, entries, cross) + variance
    scale, shift = 1.0 / np.sqrt(s), innovation / s
    for i in range(mean.size):
        mean[i] += cross[i] * shift
        cross[i] *= scale
    for i in range(mean.size):
        gain = cross[i]
        if gain != 0.0:
            row = covariance[i]
            for j in range(mean.size):
                row[j] -= gain * cross[j]
    return float(-0.5 * (np.log(2.0 * np.pi * s) + innovation * shift))


@compiled
def joint_update(
    mean: Array,
    covariance: Array,
    index: Index,
    value: Array,
    entries: Index,
    innovation: Array,
    variance: Array,
) -> float:
    """Correct a Gaussian, in place, by m measurements linearised at its mean; their joint log density.

    Parameters
    ----------
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The Gaussian.
    index, value : ndarray, shape (m, E)
        Where each measurement's derivatives are not zero, and what they are.
    entries : ndarray of int64, shape (m,)
        How many each has.
    innovation, variance : ndarray, shape (m,)
        Measured minus predicted, and variances of the measurements.
    """
    before, cross = mean.copy(), np.empty(mean.size)
    log_density = 0.0
    for i in range(innovation.size):
        moved = 0.0
        for e in range(entries[i]):
            moved += value[i, e] * (mean[index[i, e]] - before[index[i, e]])
        log_density += scalar_update(
            mean, covariance, index[i], value[i], entries[i], innovation[i] - moved, variance[i], cross
        )
    return log_density
