"""Directions of arrival of features: predictions, likelihoods and corrections.

A path arrives from its source: the anchor, or its image. With the heading held, directions are measured
from the axes of the start and tell the rotation of the map. With the heading unknown they share one
unknown angle per epoch, which is integrated out: only the angles between paths inform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.features import MOST_ENTRIES, gradient, sources
from estimator.slam.models.kalman import projected, scalar_update
from estimator.slam.models.settings import Settings, positive
from estimator.slam.models.state_vector import THETA, Layout

__all__ = [
    "Directions",
    "azimuth_gradient",
    "azimuth_of",
    "common_heading",
    "direction_ratio",
    "predict_azimuths",
    "update_by_directions",
    "wrapped",
]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_ANY_HEADING_RAD2 = (2.0 * np.pi) ** 2 / 12.0  # variance of an angle of which nothing is known


@dataclass(frozen=True)
class Directions(Settings):
    """How directions are used where the heading is not held.

    Parameters
    ----------
    agree_rad : float
        Directions closer than this propose one heading: a few times the error of a single one.
    direction_gate_sigma : float
        A direction farther than this from the heading that the others propose is left out, standard
        deviations.
    """

    agree_rad: float = positive(0.05)
    direction_gate_sigma: float = positive(4.0)


@compiled
def wrapped(angle: float) -> float:
    """An angle in (-pi, pi]."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


@compiled
def azimuth_of(mean: Array, source: Array, k: int, f: int) -> float:
    """Direction of arrival of a feature, from the expected direction of the gauge frame's x axis, radians."""
    return float(np.arctan2(source[k, f, 1] - mean[1], source[k, f, 0] - mean[0]) + mean[THETA])


@compiled
def azimuth_gradient(
    layout: Layout, mean: Array, source: Array, k: int, f: int, index: Index, value: Array
) -> int:
    """Derivatives of a direction, the entries that are not zero; see :func:`features.gradient`."""
    dx, dy = mean[0] - source[k, f, 0], mean[1] - source[k, f, 1]
    square = max(dx * dx + dy * dy, 1e-6)
    count = gradient(layout, mean, source, k, f, -dy / square, dx / square, index, value)
    index[count], value[count] = THETA, 1.0
    return count + 1


@compiled
def direction_ratio(innovation: float, variance: float) -> float:
    """Density of a direction's innovation over that of clutter from anywhere."""
    density = np.exp(-0.5 * innovation * innovation / variance) / np.sqrt(2.0 * np.pi * variance)
    return float(2.0 * np.pi * density)


@compiled
def common_heading(innovation: Array, agree_rad: float) -> float:
    """Heading that most of the innovations (m,) agree on: the densest of those proposed, radians."""
    best, most = 0.0, -1.0
    for i in range(innovation.size):
        votes = 0.0
        for j in range(innovation.size):
            votes += np.exp(-abs(wrapped(innovation[i] - innovation[j])) / agree_rad)
        if votes > most:
            best, most = innovation[i], votes
    sine = cosine = 0.0
    for i in range(innovation.size):
        if abs(wrapped(innovation[i] - best)) < 3.0 * agree_rad:
            sine += np.sin(innovation[i])
            cosine += np.cos(innovation[i])
    return float(np.arctan2(sine, cosine))


@compiled
def update_by_directions(
    layout: Layout,
    mean: Array,
    covariance: Array,
    source: Array,
    anchor: Index,
    feature: Index,
    azimuth: Array,
    std: Array,
    heading_held: bool,
    agree_rad: float,
    gate_sigma: float,
) -> float:
    """Correct a Gaussian, in place, by the directions of paths whose features are known.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The Gaussian.
    source : ndarray, shape (K, F, 2)
        Sources at this mean.
    anchor, feature : ndarray of int64, shape (m,)
        Whose paths they are.
    azimuth, std : ndarray, shape (m,)
        Measured directions and their standard deviations, radians.
    heading_held : bool
        Whether they are measured from the axes of the start.
    agree_rad, gate_sigma : float
        As in :class:`Directions`.

    Returns
    -------
    float
        Log density of the directions over that of directions from anywhere.
    """
    count, n = azimuth.size, mean.size
    innovation, spread = np.empty(count), np.empty(count)
    # the unknown heading is one more state, forgotten afterwards
    wide_mean, wide = np.zeros(n + 1), np.zeros((n + 1, n + 1))
    wide_mean[:n] = mean
    wide[:n, :n] = covariance
    index = np.empty((count, MOST_ENTRIES + 1), dtype=np.int64)
    value = np.empty((count, MOST_ENTRIES + 1))
    entries = np.empty(count, dtype=np.int64)
    cross = np.empty(n + 1)
    for i in range(count):
        k, f = anchor[i], feature[i]
        innovation[i] = wrapped(azimuth[i] - azimuth_of(mean, source, k, f))
        entries[i] = azimuth_gradient(layout, mean, source, k, f, index[i], value[i])
        spread[i] = projected(wide, index[i], value[i], entries[i], cross)
    heading = 0.0
    if not heading_held:
        heading = common_heading(innovation, agree_rad)
        wide[n, n] = _ANY_HEADING_RAD2
    log_density = 0.0
    for i in range(count):
        gap = wrapped(innovation[i] - heading)
        last = entries[i]
        if not heading_held:
            if gap * gap >= gate_sigma**2 * (2.0 * spread[i] + std[i] ** 2):
                continue
            index[i, last], value[i, last] = n, 1.0
            last += 1
        moved = wide_mean[n] if not heading_held else 0.0
        for e in range(entries[i]):
            moved += value[i, e] * (wide_mean[index[i, e]] - mean[index[i, e]])
        log_density += np.log(2.0 * np.pi) + scalar_update(
            wide_mean, wide, index[i], value[i], last, gap - moved, std[i] ** 2, cross
        )
    mean[:] = wide_mean[:n]
    covariance[:, :] = wide[:n, :n]
    return log_density


@compiled
def _predict_all(layout: Layout, mean: Array, feature: Index) -> tuple[Array, Array]:
    count, anchors, columns = feature.shape
    features = 1 + layout.slots + (layout.slots * layout.slots if layout.shared else 0)
    every = np.ones((anchors, features), dtype=np.bool_)
    azimuth, jacobian = np.empty(feature.shape), np.zeros((count, anchors, columns, mean.shape[1]))
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    for r in range(count):
        source = sources(layout, mean[r], every)
        for k in range(anchors):
            for c in range(columns):
                azimuth[r, k, c] = azimuth_of(mean[r], source, k, feature[r, k, c])
                entries = azimuth_gradient(layout, mean[r], source, k, feature[r, k, c], index, value)
                for e in range(entries):
                    jacobian[r, k, c, index[e]] += value[e]
    return azimuth, jacobian


def predict_azimuths(mean: Array, layout: Layout, feature: Index | None = None) -> tuple[Array, Array]:
    """Directions of arrival of features and their derivatives.

    Angles are measured from the expected direction of the gauge frame's x axis, so that ``theta`` adds
    to them.

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors.
    layout : Layout
        Positions in the state vector.
    feature : ndarray of int64, shape (R, K, C), optional
        Which features of each anchor; by default all, in order.

    Returns
    -------
    azimuth : ndarray, shape (R, K, C)
        Radians, not wrapped.
    jacobian : ndarray, shape (R, K, C, n)
        Derivatives by the state vector.
    """
    if feature is None:
        feature = np.broadcast_to(np.arange(layout.features), (len(mean), layout.anchors, layout.features))
    return _predict_all(layout, np.ascontiguousarray(mean), np.ascontiguousarray(feature))
