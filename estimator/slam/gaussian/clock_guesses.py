"""Guesses of a clock bias that is new in every epoch: what most paths agree on.

Where nothing is known of the bias beforehand, every path may come from every feature, and association feature
by feature knows nothing. But all paths share the bias: with the right one most of them fit a feature, with
another a few do by chance. Each hypothesis therefore goes on with the biases that explain most, as a mixture
whose parts the prior weighs; the paths themselves then tell the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import MOST_ENTRIES, active_features, possible_paths, sources
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.kalman import projected
from estimator.slam.models.ordering import descending
from estimator.slam.models.path_lengths import length_gradient, path_lengths
from estimator.slam.models.settings import Settings, positive, probability
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["ClockGuesses", "with_clock_guesses"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class ClockGuesses(Settings):
    """How the bias of an epoch is guessed.

    Parameters
    ----------
    guess_std_m : float
        Standard deviation of a guess where the agent's place is known, metres: wide enough that the paths
        decide.
    guess_nats : float
        Guesses whose log likelihood is so much less than the best are left out.
    most_guesses : int
        Where more are left, the paths do not tell the bias, and the hypothesis goes on as it is.
    guess_chance : float
        Features that are measured with less probability propose nothing.
    """

    guess_std_m: float = positive(1.0)
    guess_nats: float = positive(10.0)
    most_guesses: int = positive(6)
    guess_chance: float = probability(0.2)


@compiled
def _scores(
    layout: Layout,
    mean: Array,
    covariance: Array,
    active: Mask,
    chance: Array,
    paths: EpochPaths,
    clutter: Array,
    least_chance: float,
) -> tuple[Array, Array, float]:
    """Biases (C,) that pairs of a path and a feature propose, their log likelihoods, and a variance.

    Biases are differences to the expected one. The variance is the largest of a predicted length, the bias
    apart. Time is quadratic in pairs.
    """
    source = sources(layout, mean, active)
    slanted = path_lengths(layout, mean, source)
    possible = possible_paths(layout, mean, source, active)
    index, value, cross = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES), np.empty(mean.size)
    count, most = 0, layout.anchors * (1 + layout.slots)
    anchor, spread = np.empty(most, dtype=np.int64), np.empty(most)
    expected, share = np.empty(most), np.empty(most)
    for k in range(layout.anchors):
        b = FIRST_ANCHOR + PER_ANCHOR * k + 3
        for f in range(1 + layout.slots):
            if not possible[k, f] or chance[k, f] < least_chance or paths.number[k] == 0:
                continue
            entries = length_gradient(layout, mean, source, k, f, slanted[k, f], index, value)
            total = projected(covariance, index, value, entries, cross)
            anchor[count], expected[count] = k, slanted[k, f] + mean[b]
            # of the bias, what is common to all is what is guessed
            spread[count] = max(total - 2.0 * cross[b] + covariance[b, b], 0.0)
            share[count] = chance[k, f]
            count += 1
    pairs = 0
    for c in range(count):
        pairs += paths.number[anchor[c]]
    shift, score = np.empty(pairs), np.zeros(pairs)
    g = 0
    for c in range(count):
        for j in range(paths.number[anchor[c]]):
            shift[g] = paths.length_m[anchor[c], j] - expected[c]
            g += 1
    for g in range(pairs):
        for k in range(layout.anchors):
            for j in range(paths.number[k]):
                ratio = 0.0
                for c in range(count):
                    if anchor[c] == k:
                        variance = spread[c] + paths.std_m[k, j] ** 2
                        gap = paths.length_m[k, j] - expected[c] - shift[g]
                        density = np.exp(-0.5 * gap * gap / variance) / np.sqrt(2.0 * np.pi * variance)
                        ratio += share[c] * density
                score[g] += np.log1p(ratio / clutter[k])
    return shift, score, spread[:count].max() if count else 0.0


@compiled
def _chosen(shift: Array, score: Array, apart_m: float, nats: float) -> Index:
    """The best biases, none closer than ``apart_m`` to a better one or ``nats`` below the best."""
    order = descending(score)
    kept, count = np.empty(order.size, dtype=np.int64), 0
    for g in order:
        if score[g] < score[order[0]] - nats:
            break
        near = False
        for i in range(count):
            near = near or abs(shift[kept[i]] - shift[g]) < apart_m
        if not near:
            kept[count] = g
            count += 1
    return kept[:count]


def with_clock_guesses(
    layout: Layout,
    hypotheses: Hypotheses,
    confirmed: Mask,
    owner: Index,
    paths: EpochPaths,
    clutter: Array,
    detection_probability: float,
    model: ClockGuesses,
) -> Hypotheses:
    """The hypotheses, those with a located anchor once for each bias that their paths may mean.

    Time is that of hypotheses times the square of pairs of a path and a feature.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    hypotheses : Hypotheses
        Predicted; their biases are not known.
    confirmed : ndarray of bool, shape (L,)
        Slots that count as found.
    owner : ndarray of int64, shape (L,)
        The anchor of each virtual anchor.
    paths : EpochPaths
        The epoch's paths.
    clutter : ndarray, shape (K,)
        Intensity per metre of paths that no feature gives.
    detection_probability : float
        Probability that a visible feature is measured.
    model : ClockGuesses
        How many guesses.
    """
    bias = np.array([layout.bias(k) for k in range(layout.anchors)])
    parent: list[int] = []
    moved: list[float] = []
    left: list[float] = []
    for r in range(hypotheses.number):
        mean, covariance = hypotheses.mean[r], hypotheses.covariance[r]
        active = active_features(layout, hypotheses.located[r], hypotheses.present[r], confirmed, owner)
        chance = detection_probability * hypotheses.visibility[r]
        shift, score, spread = _scores(
            layout, mean, covariance, active, chance, paths, clutter, model.guess_chance
        )
        std = model.guess_std_m + float(np.sqrt(spread))
        chosen = _chosen(shift, score, std, model.guess_nats) if shift.size else np.empty(0, dtype=np.int64)
        known = np.sqrt(covariance[bias[0], bias[0]]) < std
        if known or not 0 < len(chosen) <= model.most_guesses:
            parent.append(r)
            moved.append(0.0)
            left.append(np.inf)
            continue
        for g in chosen:
            parent.append(r)
            moved.append(float(shift[g]))
            left.append(std**2)
    guessed = hypotheses.take(np.array(parent))
    for i, (shift_m, variance) in enumerate(zip(moved, left, strict=True)):
        before = guessed.covariance[i][np.ix_(bias, bias)]
        common = float(before.mean())
        if variance < common:
            guessed.mean[i, bias] += shift_m
            guessed.covariance[i][np.ix_(bias, bias)] = before - common + variance
            guessed.log_weight[i] -= 0.5 * (shift_m**2 / common + np.log(common / variance))
    return guessed
