"""Branching: ambiguous measurements of an epoch, decided every way or moment-matched.

An ambiguity whose alternatives would move a hypothesis far apart, against the uncertainty that each
would leave, is decided every way: one hypothesis per alternative. The alternative is taken at once, and
what is left predicted and associated again: where one cause moves all features alike (the agent's first
step, of unknown speed), the next ambiguity is judged by what this one told, and the evidence of a
hypothesis is that of its measurements together. What would hardly move a hypothesis is taken by its
probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.association.belief_propagation import associate
from estimator.slam.association.exchange import with_exchange
from estimator.slam.association.gating import GatedPairs, GateModel, gate, path_variance
from estimator.slam.gaussian.branches import Branches, copy_branch, room_for
from estimator.slam.models.directions import azimuth_gradient, azimuth_of, wrapped
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import MOST_ENTRIES, sources
from estimator.slam.models.kalman import joint_update, scalar_update
from estimator.slam.models.ordering import descending, taken
from estimator.slam.models.path_lengths import path_lengths
from estimator.slam.models.settings import Settings, positive, probability
from estimator.slam.models.state_vector import Layout

__all__ = ["BranchModel", "Branching", "resolve"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Branching(Settings):
    """When hypotheses branch.

    Parameters
    ----------
    sure_probability : float
        Association probability that is beyond doubt: such pairs are taken first, all at once.
    exchange_odds : float
        Odds of an exchange with another feature from which a pair is not beyond doubt.
    spread_ratio : float
        A hypothesis branches if its alternatives would move it by more than this many of the standard
        deviations that each would leave.
    ambiguities : int
        Ambiguities of one epoch that a hypothesis branches for,
    few_hypotheses, many_hypotheses : int
        or one if there are more hypotheses than ``few``; of a likely hypothesis, than ``many``.
    likely_nats : float
        A likely hypothesis is at most this far below the best.
    least_probability : float
        Of an alternative worth a hypothesis,
    most_alternatives : int
        of which an ambiguity has at most so many.
    most_branches : int
        Hypotheses of one epoch at most, before they are reduced; then what is left is moment-matched. Bounds
        time and memory.
    least_detected : float
        Moment-matched features detected with less probability correct nothing.
    """

    sure_probability: float = probability(0.998)
    exchange_odds: float = positive(0.002)
    spread_ratio: float = positive(0.5)
    ambiguities: int = positive(3)
    few_hypotheses: int = positive(64)
    many_hypotheses: int = positive(256)
    likely_nats: float = positive(5.0)
    least_probability: float = probability(1e-3)
    most_alternatives: int = positive(30)
    most_branches: int = positive(1000)
    least_detected: float = probability(0.05)


class BranchModel(NamedTuple):
    """What compiled branching needs to know: of :class:`Branching`, and ``pair_std_m`` of gating."""

    sure_probability: float
    exchange_odds: float
    spread_ratio: float
    ambiguities: int
    few_hypotheses: int
    many_hypotheses: int
    likely_nats: float
    least_probability: float
    most_alternatives: int
    most_branches: int
    least_detected: float
    pair_std_m: float


@compiled
def _spread_ratio(gated: GatedPairs, c: int, share: Array, paths: EpochPaths, range_std_m: float) -> float:
    """Scatter that the alternatives of feature ``c`` give the path length, over the variance they leave."""
    k, spread = gated.anchor[c], gated.spread_m2[c]
    first = second = 0.0
    least = np.inf
    for j in range(paths.number[k]):
        noise = path_variance(paths, k, j, range_std_m)
        gain = spread / (spread + noise)
        shift = gain * gated.innovation_m[c, j]
        first += share[c, j] * shift
        second += share[c, j] * shift * shift
        least = min(least, gain * noise)
    return (second - first * first) / max(least, 1e-8)


@compiled
def _sources_of(layout: Layout, mean: Array, k: int, f: int, features: int) -> Array:
    """Sources (K, F, 2) at a mean, of one feature and the images that it goes over."""
    chosen = np.zeros((layout.anchors, features), dtype=np.bool_)
    chosen[k, : 1 + layout.slots] = True
    chosen[k, f] = True
    return sources(layout, mean, chosen)


@compiled
def _take_direction(
    layout: Layout,
    mean: Array,
    covariance: Array,
    source: Array,
    k: int,
    f: int,
    innovation: float,
    variance: float,
) -> None:
    """Correct a Gaussian, in place, by an innovation of the direction of a feature."""
    index, value = np.empty(MOST_ENTRIES, dtype=np.int64), np.empty(MOST_ENTRIES)
    entries = azimuth_gradient(layout, mean, source, k, f, index, value)
    scalar_update(mean, covariance, index, value, entries, innovation, variance, np.empty(mean.size))


@compiled
def _decide(
    layout: Layout,
    branches: Branches,
    b: int,
    gated: GatedPairs,
    c: int,
    j: int,
    paths: EpochPaths,
    range_std_m: float,
) -> None:
    """Take one alternative: measurement ``j`` of feature ``c``, or none where that is -1."""
    k, f = gated.anchor[c], gated.feature[c]
    branches.could[b, k, f] = False
    if j < 0:
        return
    branches.log_evidence[b] += np.log(gated.ratio[c, j])
    branches.detected[b, k, f] = 1.0
    branches.explained[b, k, j] = 1.0
    branches.free[b, k, j] = False
    mean, covariance = branches.mean[b], branches.covariance[b]
    scalar_update(
        mean,
        covariance,
        gated.position[c],
        gated.value[c],
        gated.entries[c],
        gated.innovation_m[c, j],
        path_variance(paths, k, j, range_std_m),
        np.empty(mean.size),
    )
    if paths.heading_held and np.isfinite(paths.azimuth_std_rad[k, j]):
        source = _sources_of(layout, mean, k, f, branches.could.shape[2])
        innovation = wrapped(paths.azimuth_rad[k, j] - azimuth_of(mean, source, k, f))
        variance = paths.azimuth_std_rad[k, j] ** 2
        _take_direction(layout, mean, covariance, source, k, f, innovation, variance)


@compiled
def _moment_match(
    layout: Layout,
    model: BranchModel,
    branches: Branches,
    b: int,
    gated: GatedPairs,
    share: Array,
    evidence: float,
    paths: EpochPaths,
    range_std_m: float,
) -> None:
    """Take all that is left at once, by its association probabilities ``share`` (C, M)."""
    count = gated.anchor.size
    used = np.empty(count, dtype=np.int64)
    expected, variance, weight = np.empty(count), np.empty(count), np.zeros(count)
    m = 0
    for c in range(count):
        k, f = gated.anchor[c], gated.feature[c]
        for j in range(paths.number[k]):
            weight[c] += share[c, j]
        branches.detected[b, k, f] = weight[c]
        if not weight[c] > model.least_detected:
            continue
        if layout.shared and f > layout.slots and not gated.spread_m2[c] < model.pair_std_m**2:
            continue
        first = second = 0.0
        for j in range(paths.number[k]):
            innovation = gated.innovation_m[c, j]
            first += share[c, j] * innovation
            noise = path_variance(paths, k, j, range_std_m)
            second += share[c, j] * (innovation * innovation + noise)
        first, second = first / weight[c], second / weight[c]
        used[m], expected[m], variance[m] = c, first, (second - first * first) / weight[c]
        m += 1
    for k in range(layout.anchors):
        for j in range(paths.number[k]):
            total = 0.0
            for c in range(gated.begin[k], gated.begin[k + 1]):
                total += share[c, j]
            branches.explained[b, k, j] = max(branches.explained[b, k, j], total)
    branches.log_evidence[b] += evidence
    mean, covariance = branches.mean[b], branches.covariance[b]
    used = used[:m]
    joint_update(
        mean,
        covariance,
        taken(gated.position, used),
        taken(gated.value, used),
        taken(gated.entries, used),
        expected[:m],
        variance[:m],
    )
    if not paths.heading_held:
        return
    for i in range(m):
        c = used[i]
        k, f = gated.anchor[c], gated.feature[c]
        given = first = second = 0.0
        source = _sources_of(layout, mean, k, f, branches.could.shape[2])
        azimuth = azimuth_of(mean, source, k, f)
        for j in range(paths.number[k]):
            if share[c, j] > 0.0 and np.isfinite(paths.azimuth_std_rad[k, j]):
                innovation = wrapped(paths.azimuth_rad[k, j] - azimuth)
                given += share[c, j]
                first += share[c, j] * innovation
                second += share[c, j] * (innovation * innovation + paths.azimuth_std_rad[k, j] ** 2)
        if given > model.least_detected:
            first, second = first / given, second / given
            variance_of = (second - first * first) / given
            _take_direction(layout, mean, covariance, source, k, f, first, variance_of)


@compiled
def resolve(
    layout: Layout,
    model: BranchModel,
    gates: GateModel,
    branches: Branches,
    count: int,
    ambiguous: Index,
    likely: Mask,
    chance: Array,
    paths: EpochPaths,
    clutter: Array,
) -> tuple[Branches, int]:
    """Take all that is left of an epoch, and branch the hypotheses that would blur.

    Time and memory are those of ``most_branches`` hypotheses, each associated at most once per ambiguity.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    model, gates : BranchModel, GateModel
        Limits, gates and noise.
    branches : Branches
        Hypotheses, ``count`` of them.
    count : int
        How many there are.
    ambiguous : ndarray of int64
        Those with measurements left that might fit a feature.
    likely : ndarray of bool, shape (R,)
        By parent: hypotheses that branch among more than the others do.
    chance : ndarray, shape (R, K, F)
        By parent: probability that each feature is measured.
    paths : EpochPaths
        The measurements.
    clutter : ndarray, shape (K,)
        Intensity per metre of paths that no feature gives.

    Returns
    -------
    branches : Branches
        All of them, the new ones at the end.
    count : int
        How many there are.
    """
    pending = ambiguous
    for turn in range(model.ambiguities + 1):
        following, waiting = np.empty(model.most_branches, dtype=np.int64), 0
        size = count
        for b in pending:
            parent = branches.parent[b]
            mean, covariance = branches.mean[b], branches.covariance[b]
            source = sources(layout, mean, _needed(layout, branches.could[b]))
            slanted = path_lengths(layout, mean, source)
            gated = gate(
                layout,
                gates,
                mean,
                covariance,
                source,
                slanted,
                chance[parent],
                branches.could[b],
                branches.free[b],
                paths,
                clutter,
            )
            share = np.zeros(gated.ratio.shape)
            evidence = 0.0
            for k in range(layout.anchors):
                own = slice(gated.begin[k], gated.begin[k + 1])
                message = np.empty(gated.ratio[own].shape)
                evidence += associate(gated.ratio[own], share[own], message)
                with_exchange(share[own], gated.ratio[own])
            worst, most = -1, 0.0
            for c in range(gated.anchor.size):
                ratio = _spread_ratio(gated, c, share, paths, gates.range_std_m)
                if ratio > most:
                    worst, most = c, ratio
            limit = model.many_hypotheses if likely[parent] else model.few_hypotheses
            branching = turn < model.ambiguities and most >= model.spread_ratio**2
            branching = branching and (turn == 0 or size <= limit)
            if branching and count + model.most_alternatives > model.most_branches:
                branching = False
            if not branching:
                _moment_match(layout, model, branches, b, gated, share, evidence, paths, gates.range_std_m)
                continue
            k = gated.anchor[worst]
            alternatives = np.empty(paths.number[k] + 1)
            alternatives[-1] = 1.0
            for j in range(paths.number[k]):
                alternatives[j] = share[worst, j]
                alternatives[-1] -= share[worst, j]
            alternatives[-1] = max(alternatives[-1], 0.0)
            order = descending(alternatives)
            chosen = 1
            while (
                chosen < min(order.size, model.most_alternatives)
                and alternatives[order[chosen]] > model.least_probability
            ):
                chosen += 1
            branches = room_for(branches, count + chosen)
            for i in range(chosen - 1, -1, -1):
                target = b
                if i > 0:
                    target = count
                    count += 1
                    copy_branch(branches, b, target)
                j = order[i] if order[i] < paths.number[k] else -1
                _decide(layout, branches, target, gated, worst, j, paths, gates.range_std_m)
                following[waiting] = target
                waiting += 1
        pending = following[:waiting]
        if waiting == 0:
            break
    return branches, count


@compiled
def _needed(layout: Layout, could: Mask) -> Mask:
    """Features whose sources are needed for those that could be heard: pairs need their first image."""
    needed = could.copy()
    if layout.shared:
        slots = layout.slots
        for k in range(layout.anchors):
            for i in range(slots):
                for j in range(slots):
                    if could[k, 1 + slots + i * slots + j]:
                        needed[k, 1 + i] = True
    return needed
