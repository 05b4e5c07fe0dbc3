"""Path lengths of features, h(x), and their derivatives.

A path of horizontal length d from an anchor ``w`` square metres of squared height away, whose clock is ``b``
metres off and whose ranges are out of scale by ``s``, is ``(1 + s) sqrt(d^2 + w) + b`` long
(:mod:`estimator.slam.models.state_vector`); d is the distance from its source to the agent
(:mod:`estimator.slam.models.features`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.features import MOST_ENTRIES, gradient, possible_paths, sources
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["Prediction", "length_gradient", "path_lengths", "predict_paths"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@compiled
def path_lengths(layout: Layout, mean: Array, source: Array) -> Array:
    """Lengths (K, F) without the clock bias: scaled slanted distances from the sources (K, F, 2), metres."""
    anchors, features = source.shape[0], source.shape[1]
    slanted = np.empty((anchors, features))
    for k in range(anchors):
        height2 = mean[FIRST_ANCHOR + PER_ANCHOR * k + 2]
        scale = 1.0 + mean[FIRST_ANCHOR + PER_ANCHOR * k + 4]
        for f in range(features):
            dx, dy = mean[0] - source[k, f, 0], mean[1] - source[k, f, 1]
            slanted[k, f] = scale * np.sqrt(max(dx * dx + dy * dy + height2, 1e-6))
    return slanted


@compiled
def length_gradient(
    layout: Layout, mean: Array, source: Array, k: int, f: int, slanted: float, index: Index, value: Array
) -> int:
    """Derivatives of a path length, the entries that are not zero; see :func:`features.gradient`."""
    a = FIRST_ANCHOR + PER_ANCHOR * k
    scale = 1.0 + mean[a + 4]
    distance = slanted / scale
    cx = scale * (mean[0] - source[k, f, 0]) / distance
    cy = scale * (mean[1] - source[k, f, 1]) / distance
    count = gradient(layout, mean, source, k, f, cx, cy, index, value)
    index[count], value[count] = a + 2, 0.5 * scale / distance
    index[count + 1], value[count + 1] = a + 3, 1.0
    index[count + 2], value[count + 2] = a + 4, distance
    return count + 3


@compiled
def _predict_all(layout: Layout, mean: Array) -> tuple[Array, Array, Mask]:
    """Slanted lengths, sources and possibility of all features of vectors (R, n)."""
    count, anchors = mean.shape[0], layout.anchors
    features = 1 + layout.slots + (layout.slots * layout.slots if layout.shared else 0)
    slanted = np.empty((count, anchors, features))
    source = np.empty((count, anchors, features, 2))
    possible = np.empty((count, anchors, features), dtype=np.bool_)
    every = np.ones((anchors, features), dtype=np.bool_)
    if layout.shared:
        for i in range(layout.slots):
            every[:, 1 + layout.slots + i * layout.slots + i] = False
    for r in range(count):
        source[r] = sources(layout, mean[r], np.ones((anchors, features), dtype=np.bool_))
        slanted[r] = path_lengths(layout, mean[r], source[r])
        possible[r] = possible_paths(layout, mean[r], source[r], every)
    return slanted, source, possible


@compiled
def _derivatives(layout: Layout, mean: Array, source: Array, slanted: Array, feature: Index) -> Array:
    """Dense derivatives (R, K, C, n) of the lengths of features (R, K, C)."""
    count, anchors, columns = feature.shape
    jacobian = np.zeros((count, anchors, columns, mean.shape[1]))
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    for r in range(count):
        for k in range(anchors):
            for c in range(columns):
                f = feature[r, k, c]
                entries = length_gradient(layout, mean[r], source[r], k, f, slanted[r, k, f], index, value)
                for e in range(entries):
                    jacobian[r, k, c, index[e]] += value[e]
    return jacobian


@dataclass(frozen=True, eq=False)
class Prediction:
    """Expected path lengths of all features of all anchors, of R state vectors.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean : ndarray, shape (R, n)
        The state vectors.
    length_m : ndarray, shape (R, K, F)
        Path lengths.
    slanted_m : ndarray, shape (R, K, F)
        The same without the clock bias.
    source_m : ndarray, shape (R, K, F, 2)
        Where the paths seem to come from.
    possible : ndarray of bool, shape (R, K, F)
        Whether the bounces are geometrically possible if walls had no ends.
    """

    layout: Layout
    mean: Array
    length_m: Array
    slanted_m: Array
    source_m: Array
    possible: Mask

    def derivatives(self, feature: Index) -> Array:
        """Derivatives (R, K, C, n) of the lengths of features ``feature`` (R, K, C)."""
        feature = np.ascontiguousarray(feature)
        return _derivatives(self.layout, self.mean, self.source_m, self.slanted_m, feature)

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives (R, K, F, n) of all lengths by the state vector."""
        every = np.arange(self.length_m.shape[2])
        return self.derivatives(np.broadcast_to(every, self.length_m.shape))


def predict_paths(mean: Array, layout: Layout) -> Prediction:
    """Path lengths, derivatives and geometric possibility of all features.

    Time and memory are those of R K (1 + L + L^2) features.

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors; empty slots and unknown anchors may hold any finite, non-zero numbers
        (their features are the caller's to mask).
    layout : Layout
        Positions in the state vector.
    """
    mean = np.ascontiguousarray(mean)
    slanted, source, possible = _predict_all(layout, mean)
    bias = mean[:, FIRST_ANCHOR + 3 : layout.walls.start : PER_ANCHOR]
    return Prediction(layout, mean, slanted + bias[:, :, None], slanted, source, possible)
