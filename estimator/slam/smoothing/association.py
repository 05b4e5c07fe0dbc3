"""Associate the paths of a whole run with what the run found.

Lengths are predicted along a trajectory; a two-state chain along the epochs tells from the hits and
misses of each feature when it could be heard (:func:`visibility`); belief propagation shares out the
paths of each epoch (:mod:`estimator.slam.association`), and those beyond doubt become factors of the
smoother (:func:`path_factors`). Time goes with epochs, anchors and the pairs of a feature and a path;
memory with epochs, anchors and features.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.compiled import compiled
from estimator.slam.association.belief_propagation import associate
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.visibility import Visibility
from estimator.slam.smoothing.factors import PathFactors, Problem, Trajectory

__all__ = ["RunPaths", "path_factors", "stacked_paths", "visibility"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
_ROUNDS = 2  # without competition first, then with what belief propagation leaves of it
_SURE = 0.999  # the greatest chance of a detection: ratios stay finite


class RunPaths(NamedTuple):
    """The paths of all epochs, K anchors with up to M paths; compiled functions take it as it is.

    Parameters
    ----------
    number : ndarray of int64, shape (T, K)
        Paths of each anchor.
    length_m, std_m, azimuth_rad, azimuth_std_rad : ndarray, shape (T, K, M)
        As in :class:`estimator.slam.models.epoch_paths.EpochPaths`; directions of an epoch whose heading
        was not held are left out.
    asked : ndarray of bool, shape (T, K)
        Which anchors were asked.
    """

    number: Index
    length_m: Array
    std_m: Array
    azimuth_rad: Array
    azimuth_std_rad: Array
    asked: Mask

    @property
    def valid(self) -> Mask:
        """Which entries (T, K, M) are measurements."""
        return np.asarray(np.arange(self.length_m.shape[2]) < self.number[..., None])


class _Model(NamedTuple):
    """What pairs of a feature and a path are judged by."""

    gate_sigma: float
    clutter_density: float
    range_std_m: float


def stacked_paths(tables: Sequence[EpochPaths]) -> RunPaths:
    """The paths of all epochs in one table."""
    shape = (len(tables), len(tables[0].number), max(table.length_m.shape[1] for table in tables))
    length, std = np.zeros(shape), np.ones(shape)
    azimuth, azimuth_std = np.zeros(shape), np.full(shape, np.inf)
    for t, table in enumerate(tables):
        count = table.length_m.shape[1]
        length[t, :, :count], std[t, :, :count] = table.length_m, table.std_m
        if table.heading_held:
            azimuth[t, :, :count], azimuth_std[t, :, :count] = table.azimuth_rad, table.azimuth_std_rad
    number, asked = np.array([table.number for table in tables]), np.array([table.asked for table in tables])
    return RunPaths(number, length, std, azimuth, azimuth_std, asked)


def path_factors(
    problem: Problem,
    at: Trajectory,
    paths: RunPaths,
    located: Mask,
    spread_m2: ArrayLike,
    least_probability: float = 0.5,
) -> PathFactors:
    """Associate the paths of all epochs with the features of a trajectory.

    Parameters
    ----------
    problem : Problem
        Layout and models; its factors are not used.
    at : Trajectory
        Where everything is.
    paths : RunPaths
        The paths.
    located : ndarray of bool, shape (K,)
        Anchors that ``at`` knows.
    spread_m2 : array_like, broadcasts to (T, K, F)
        Variances of the predicted lengths, square metres.
    least_probability : float
        A path becomes a factor of its likeliest feature if it belongs to it with at least this probability.

    Returns
    -------
    PathFactors
    """
    noise, gating, layout = problem.config.noise, problem.config.gating, problem.layout
    prediction = predict_paths(at.states(), layout)
    spread = np.ascontiguousarray(np.broadcast_to(np.asarray(spread_m2, float), prediction.length_m.shape))
    usable = prediction.possible & located[:, None]
    usable[..., 1 + layout.slots :] &= spread[..., 1 + layout.slots :] < gating.pair_std_m**2
    model = _Model(gating.gate_sigma, noise.clutter_density, noise.range_std_m)
    pd = noise.detection_probability
    heard, feature = _share(paths, prediction.length_m, spread, usable, np.zeros(usable.shape), model, 1.0)
    for _ in range(_ROUNDS):
        asked = np.broadcast_to(paths.asked[..., None], usable.shape)
        ratio = np.where(asked, 1.0 - pd + pd * heard, 1.0)
        seen = visibility(ratio, usable, problem.config.visibility, asked)
        chance = np.minimum(pd * seen, _SURE)
        odds = chance / (1.0 - chance)
        heard, feature = _share(paths, prediction.length_m, spread, usable, odds, model, least_probability)
    pick = np.nonzero(feature >= 0)
    epoch, anchor, number = pick
    std = np.maximum(paths.std_m[pick], noise.range_std_m)
    return PathFactors(
        epoch,
        anchor,
        feature[pick],
        paths.length_m[pick],
        std,
        paths.azimuth_rad[pick],
        paths.azimuth_std_rad[pick],
        number,
    )


@compiled
def _share(
    paths: RunPaths, predicted: Array, spread: Array, usable: Mask, odds: Array, model: _Model, least: float
) -> tuple[Array, Index]:
    """Share out the paths of every epoch and anchor among the features.

    Parameters
    ----------
    paths : RunPaths
        The paths.
    predicted, spread : ndarray, shape (T, K, F)
        Lengths that features give, and their variances.
    usable : ndarray of bool, shape (T, K, F)
        Features that may give any.
    odds : ndarray, shape (T, K, F)
        Chance that a feature is detected over that it is not; zeros leave out the competition.
    model : _Model
        Gate and noise.
    least : float
        Least probability of an association.

    Returns
    -------
    heard : ndarray, shape (T, K, F)
        Likelihood of a feature's paths over that of clutter, summed, each by how far it is uncontested.
    feature : ndarray of int64, shape (T, K, M)
        The likeliest feature of each path, -1 where it is less likely than ``least``.
    """
    epochs, anchors, features = predicted.shape
    heard, feature = np.zeros(predicted.shape), np.full(paths.length_m.shape, -1)
    for t in range(epochs):
        for k in range(anchors):
            count = paths.number[t, k]
            relative = np.zeros((features, count))
            ratio = np.zeros((features, count))
            for f in range(features):
                if not usable[t, k, f]:
                    continue
                for j in range(count):
                    s = spread[t, k, f] + max(paths.std_m[t, k, j], model.range_std_m) ** 2
                    gap = paths.length_m[t, k, j] - predicted[t, k, f]
                    if gap * gap < model.gate_sigma**2 * s:
                        density = np.exp(-0.5 * gap * gap / s) / np.sqrt(2.0 * np.pi * s)
                        relative[f, j] = density / model.clutter_density
                        ratio[f, j] = odds[t, k, f] * relative[f, j]
            probability, message = np.empty((features, count)), np.empty((features, count))
            associate(ratio, probability, message)
            for f in range(features):
                for j in range(count):
                    heard[t, k, f] += relative[f, j] * message[f, j]
            for j in range(count):
                best = least
                for f in range(features):
                    if probability[f, j] > best:
                        best, feature[t, k, j] = probability[f, j], f
    return heard, feature


def visibility(ratio: Array, usable: Mask, model: Visibility, asked: Mask | None = None) -> Array:
    """Probability, given the whole run, that features could be heard.

    Forward-backward algorithm of a chain with the states visible and invisible.

    Parameters
    ----------
    ratio : ndarray, shape (T, ...)
        Likelihood of each epoch's measurements if the feature was visible, over that if it was not.
    usable : ndarray of bool, shape (T, ...)
        Where the feature is geometrically possible; elsewhere it is invisible, whatever it was before.
    model : Visibility
        ``appear_probability`` and ``vanish_probability``.
    asked : ndarray of bool, shape (T, ...), optional
        Where a feature's anchor was asked: else it neither appears nor vanishes. By default everywhere.

    Returns
    -------
    ndarray, shape (T, ...)
    """
    flat = len(ratio), -1
    moves = np.ones(ratio.shape, dtype=bool) if asked is None else asked
    seen = _visibility(
        ratio.reshape(flat),
        usable.reshape(flat),
        moves.reshape(flat),
        model.appear_probability,
        model.vanish_probability,
    )
    return seen.reshape(ratio.shape)


@compiled
def _visibility(ratio: Array, usable: Mask, asked: Mask, appear: float, vanish: float) -> Array:
    """:func:`visibility` of F features (T, F)."""
    epochs, features = ratio.shape
    result, stay = np.empty(ratio.shape), 1.0 - vanish
    chance = np.full(features, 0.5)
    for t in range(epochs):  # forward; the result holds the filter's probabilities
        for f in range(features):
            if t > 0 and asked[t, f]:
                chance[f] = stay * chance[f] + appear * (1.0 - chance[f])
            if not usable[t, f]:
                chance[f] = 0.0
            odds = chance[f] * ratio[t, f]
            result[t, f] = odds / (odds + 1.0 - chance[f])
            chance[f] = result[t, f]
    visible, invisible = np.ones(features), np.ones(features)  # likelihoods of the future
    for t in range(epochs - 1, -1, -1):
        for f in range(features):
            one, other = result[t, f] * visible[f], (1.0 - result[t, f]) * invisible[f]
            result[t, f] = one / (one + other)
            seen, unseen = visible[f] * ratio[t, f], invisible[f]
            one = other = unseen
            if usable[t, f] and not asked[t, f]:
                one, other = seen, unseen
            elif usable[t, f]:
                one = stay * seen + vanish * unseen
                other = appear * seen + (1.0 - appear) * unseen
            visible[f], invisible[f] = one / (one + other), other / (one + other)
    return result
