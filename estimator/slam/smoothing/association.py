"""Associate the paths of a whole run with what the run found.

Lengths are predicted along a trajectory; a two-state chain along the epochs tells from the hits and
misses of each feature when it could be heard (:func:`visibility`); belief propagation shares out the
paths of each epoch (:mod:`estimator.slam.association`), and those beyond doubt become factors of the
smoother (:func:`path_factors`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.slam.association.belief_propagation import associate_all
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.visibility import Visibility
from estimator.slam.smoothing.factors import PathFactors, Problem, Trajectory

__all__ = ["path_factors", "stacked_lengths", "visibility"]

Array = NDArray[np.float64]


def path_factors(
    problem: Problem,
    at: Trajectory,
    tables: list[EpochPaths],
    located: NDArray[np.bool_],
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
    tables : list of EpochPaths, length T
        The paths.
    located : ndarray of bool, shape (K,)
        Anchors that ``at`` knows.
    spread_m2 : array_like, broadcasts to (T, K, F)
        Variances of the predicted lengths, square metres.
    least_probability : float
        Paths that belong to a feature with at least this probability become factors.

    Returns
    -------
    PathFactors
    """
    noise, gating, layout = problem.config.noise, problem.config.gating, problem.layout
    prediction = predict_paths(at.states(), layout)
    spread = np.broadcast_to(np.asarray(spread_m2, dtype=np.float64), prediction.length_m.shape)
    length, std, valid = stacked_lengths(tables)
    std = np.maximum(std, noise.range_std_m)
    s = spread[..., None] + std[:, :, None, :] ** 2  # (T, K, F, M)
    gap = length[:, :, None, :] - prediction.length_m[..., None]
    density = np.exp(-0.5 * gap**2 / s) / np.sqrt(2.0 * np.pi * s)
    usable = prediction.possible & located[:, None]
    usable[..., 1 + layout.slots :] &= spread[..., 1 + layout.slots :] < gating.pair_std_m**2
    gated = valid[:, :, None, :] & usable[..., None] & (gap**2 < gating.gate_sigma**2 * s)
    relative = np.where(gated, density / noise.clutter_density, 0.0)
    pd = noise.detection_probability
    # first without competition, then with what belief propagation leaves of it
    heard = relative
    for _ in range(2):
        seen = visibility(1.0 - pd + pd * heard.sum(axis=-1), usable, problem.config.visibility)
        chance = np.minimum(pd * seen, 0.999)[..., None]
        ratio = chance / (1.0 - chance) * relative
        probability, message, _ = associate_all(ratio.reshape(-1, *ratio.shape[2:]))
        heard = relative * message.reshape(ratio.shape)
    epoch, anchor, feature, path = np.nonzero(probability.reshape(ratio.shape) > least_probability)
    azimuth, azimuth_std = _padded_azimuths(tables, length.shape)
    pick = (epoch, anchor, path)
    if not np.any(np.isfinite(azimuth_std)):
        return PathFactors(epoch, anchor, feature, length[pick], std[pick])
    return PathFactors(epoch, anchor, feature, length[pick], std[pick], azimuth[pick], azimuth_std[pick])


def visibility(ratio: Array, usable: NDArray[np.bool_], model: Visibility) -> Array:
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

    Returns
    -------
    ndarray, shape (T, ...)
    """
    stay, appear = 1.0 - model.vanish_probability, model.appear_probability
    forward = np.empty_like(ratio)
    chance = np.full(ratio.shape[1:], 0.5)
    for t in range(len(ratio)):
        chance = np.where(usable[t], chance, 0.0)
        odds = chance * ratio[t]
        forward[t] = odds / (odds + 1.0 - chance)
        chance = stay * forward[t] + appear * (1.0 - forward[t])
    result = np.empty_like(ratio)
    back = np.ones((2, *ratio.shape[1:]))  # likelihood of the future if visible, if not
    for t in range(len(ratio) - 1, -1, -1):
        visible, invisible = forward[t] * back[0], (1.0 - forward[t]) * back[1]
        result[t] = visible / (visible + invisible)
        seen, unseen = back[0] * ratio[t], back[1]
        ahead = np.stack([stay * seen + (1.0 - stay) * unseen, appear * seen + (1.0 - appear) * unseen])
        back = np.where(usable[t], ahead, unseen)
        back /= back.sum(axis=0)
    return result


def stacked_lengths(tables: list[EpochPaths]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Lengths, standard deviations and validity of all epochs' paths, (T, K, M)."""
    shape = (len(tables), len(tables[0].length_m), max(table.length_m.shape[1] for table in tables))
    length, std, valid = np.zeros(shape), np.ones(shape), np.zeros(shape, dtype=bool)
    for t, table in enumerate(tables):
        count = table.length_m.shape[1]
        length[t, :, :count], std[t, :, :count], valid[t, :, :count] = (
            table.length_m,
            table.std_m,
            table.valid,
        )
    return length, std, valid


def _padded_azimuths(tables: list[EpochPaths], shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Directions and their standard deviations (T, K, M), infinite where there is none.

    Directions of an epoch whose heading was not held are left out.
    """
    azimuth, std = np.zeros(shape), np.full(shape, np.inf)
    for t, table in enumerate(tables):
        if table.heading_held:
            count = table.azimuth_rad.shape[1]
            azimuth[t, :, :count], std[t, :, :count] = table.azimuth_rad, table.azimuth_std_rad
    return azimuth, std
