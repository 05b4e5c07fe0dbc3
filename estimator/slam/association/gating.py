"""Gating: which features may have given which measurements of an epoch, and how well each pair fits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.directions import azimuth_gradient, azimuth_of, direction_ratio, wrapped
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import MOST_ENTRIES
from estimator.slam.models.kalman import projected
from estimator.slam.models.path_lengths import length_gradient
from estimator.slam.models.settings import Settings, positive
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["GateModel", "GatedPairs", "Gating", "gate", "still_fitting"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Gating(Settings):
    """When a feature and a measurement are looked at together.

    Parameters
    ----------
    gate_sigma : float
        Largest innovation, standard deviations.
    pair_gate_std_m : float
        Double bounces predicted worse than this are left out of the association: while the
        walls are uncertain they would take the paths of others, metres.
    pair_std_m : float
        Double bounces predicted better than this inform the filter, metres.
    pair_margin : float
        Double bounces farther than this many gates from every measurement are not looked at.
    bent_share : float
        Of the shift of a prediction after a correction: by how much its linearisation may be wrong.
    """

    gate_sigma: float = positive(4.0)
    pair_gate_std_m: float = positive(0.4)
    pair_std_m: float = positive(0.5)
    pair_margin: float = positive(1.5)
    bent_share: float = positive(0.5)


class GateModel(NamedTuple):
    """What compiled gating needs to know: of :class:`Gating` and of the noise."""

    gate_sigma: float
    pair_gate_std_m: float
    pair_margin: float
    bent_share: float
    range_std_m: float


class GatedPairs(NamedTuple):
    """Features that may have given a measurement, C of all anchors together, and how well they would fit.

    Parameters
    ----------
    anchor, feature : ndarray of int64, shape (C,)
        Which features, anchor by anchor.
    begin : ndarray of int64, shape (K + 1,)
        Where the features of each anchor begin.
    position, value, entries : ndarray, shapes (C, E), (C, E) and (C,)
        Derivatives of the path lengths, those that are not zero.
    spread_m2 : ndarray, shape (C,)
        Variance of the predicted lengths that is due to the state.
    innovation_m, ratio : ndarray, shape (C, M)
        Measured minus predicted lengths; association ratios, 0 outside the gate.
    """

    anchor: Index
    feature: Index
    begin: Index
    position: Index
    value: Array
    entries: Index
    spread_m2: Array
    innovation_m: Array
    ratio: Array


@compiled
def path_variance(paths: EpochPaths, k: int, j: int, range_std_m: float) -> float:
    """Variance of a path length, square metres: at least that of ``range_std_m``."""
    std = max(paths.std_m[k, j], range_std_m)
    return float(std * std)


@compiled
def _near_any(length: float, paths: EpochPaths, free: Mask, k: int, reach: float) -> bool:
    near = False
    for j in range(paths.number[k]):
        near = near or (free[k, j] and abs(paths.length_m[k, j] - length) < reach)
    return near


@compiled
def gate(
    layout: Layout,
    model: GateModel,
    mean: Array,
    covariance: Array,
    source: Array,
    slanted: Array,
    chance: Array,
    could: Mask,
    free: Mask,
    paths: EpochPaths,
    clutter: Array,
) -> GatedPairs:
    """Pairs of features and measurements of one hypothesis.

    Time and memory are those of the features that could be heard, times the measurements.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    model : GateModel
        Gates and noise.
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The predicted Gaussian.
    source, slanted : ndarray, shapes (K, F, 2) and (K, F)
        Sources and slanted lengths at this mean.
    chance : ndarray, shape (K, F)
        Probability that each feature is measured.
    could : ndarray of bool, shape (K, F)
        Features to be looked at; of others nothing is computed.
    free : ndarray of bool, shape (K, M)
        Measurements to be looked at.
    paths : EpochPaths
        The measurements.
    clutter : ndarray, shape (K,)
        Intensity per metre of paths that no feature gives.
    """
    anchors, features, slots = layout.anchors, could.shape[1], layout.slots
    most = 0
    for k in range(anchors):
        for j in range(paths.number[k]):
            most = max(most, j + 1)
    noise = model.range_std_m**2
    for k in range(anchors):
        for j in range(paths.number[k]):
            noise = max(noise, path_variance(paths, k, j, model.range_std_m))
    reach = model.pair_margin * model.gate_sigma * np.sqrt(model.pair_gate_std_m**2 + noise)
    begin = np.zeros(anchors + 1, dtype=np.int64)
    chosen = np.empty((anchors, features), dtype=np.bool_)
    count = 0
    for k in range(anchors):
        bias = mean[FIRST_ANCHOR + PER_ANCHOR * k + 3]
        for f in range(features):
            chosen[k, f] = could[k, f] and chance[k, f] > 0.0
            if chosen[k, f] and layout.shared and f > slots:
                chosen[k, f] = _near_any(slanted[k, f] + bias, paths, free, k, reach)
            if chosen[k, f]:
                count += 1
        begin[k + 1] = count
    pairs = GatedPairs(
        np.empty(count, dtype=np.int64),
        np.empty(count, dtype=np.int64),
        begin,
        np.empty((count, MOST_ENTRIES), dtype=np.int64),
        np.empty((count, MOST_ENTRIES)),
        np.empty(count, dtype=np.int64),
        np.empty(count),
        np.zeros((count, most)),
        np.zeros((count, most)),
    )
    cross = np.empty(mean.size)
    azimuth_index, azimuth_value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    c = -1
    for k in range(anchors):
        bias = mean[FIRST_ANCHOR + PER_ANCHOR * k + 3]
        for f in range(features):
            if not chosen[k, f]:
                continue
            c += 1
            pairs.anchor[c], pairs.feature[c] = k, f
            entries = length_gradient(
                layout, mean, source, k, f, slanted[k, f], pairs.position[c], pairs.value[c]
            )
            pairs.entries[c] = entries
            spread = projected(covariance, pairs.position[c], pairs.value[c], entries, cross)
            pairs.spread_m2[c] = spread
            known = not (layout.shared and f > slots) or spread < model.pair_gate_std_m**2
            odds = chance[k, f] / ((1.0 - chance[k, f]) * clutter[k])
            azimuth, azimuth_spread = 0.0, -1.0
            for j in range(paths.number[k]):
                innovation = paths.length_m[k, j] - (slanted[k, f] + bias)
                pairs.innovation_m[c, j] = innovation
                s = spread + path_variance(paths, k, j, model.range_std_m)
                if not (known and free[k, j] and innovation * innovation < model.gate_sigma**2 * s):
                    continue
                ratio = odds * np.exp(-0.5 * innovation * innovation / s) / np.sqrt(2.0 * np.pi * s)
                if paths.heading_held and np.isfinite(paths.azimuth_std_rad[k, j]):
                    if azimuth_spread < 0.0:
                        azimuth = azimuth_of(mean, source, k, f)
                        used = azimuth_gradient(layout, mean, source, k, f, azimuth_index, azimuth_value)
                        azimuth_spread = projected(covariance, azimuth_index, azimuth_value, used, cross)
                    ratio *= direction_ratio(
                        wrapped(paths.azimuth_rad[k, j] - azimuth),
                        azimuth_spread + paths.azimuth_std_rad[k, j] ** 2,
                    )
                pairs.ratio[c, j] = ratio
    return pairs


@compiled
def still_fitting(
    model: GateModel, pairs: GatedPairs, c: int, moved: Array, free: Mask, paths: EpochPaths
) -> bool:
    """Whether a measurement that is left might fit feature ``c``, now that the mean has moved by (n,)."""
    k = pairs.anchor[c]
    shift = 0.0
    for e in range(pairs.entries[c]):
        shift += pairs.value[c, e] * moved[pairs.position[c, e]]
    for j in range(paths.number[k]):
        if free[k, j]:
            variance = pairs.spread_m2[c] + path_variance(paths, k, j, model.range_std_m)
            reach = model.gate_sigma * np.sqrt(variance)
            if abs(pairs.innovation_m[c, j] - shift) < reach + model.bent_share * abs(shift):
                return True
    return False
