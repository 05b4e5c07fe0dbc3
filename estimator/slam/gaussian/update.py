"""One epoch of path lengths into the hypotheses: gate, associate, branch, update.

Two passes. Pairs of feature and measurement that are beyond doubt are taken first,
all at once and with the joint density of their innovations; what is left is
predicted again and resolved (:mod:`estimator.slam.gaussian.branching`).
Where two paths cross, the second pass is much surer than the first would be; that the two are exchanged
is weighed exactly (:mod:`estimator.slam.association.exchange`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.association.belief_propagation import associate
from estimator.slam.association.exchange import best_exchange
from estimator.slam.association.gating import GatedPairs, GateModel, gate, path_variance, still_fitting
from estimator.slam.gaussian.branches import Branches, empty_branches
from estimator.slam.gaussian.branching import BranchModel, resolve
from estimator.slam.gaussian.polar_correction import correct_along_circles
from estimator.slam.models.directions import update_by_directions
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.features import active_features, possible_paths, sources
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.kalman import joint_update
from estimator.slam.models.ordering import descending, taken
from estimator.slam.models.path_lengths import path_lengths
from estimator.slam.models.settings import Settings, not_negative, probability
from estimator.slam.models.state_vector import Layout

__all__ = ["Corrections", "EpochUpdate", "UpdateModel", "update_hypotheses"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Corrections(Settings):
    """How corrections are taken.

    Parameters
    ----------
    most_turn_rad : float
        Largest turn of a wall that is moved along its circle round an anchor
        (:mod:`estimator.slam.gaussian.polar_correction`); 0 moves all walls as they are.
    sure_expected : float
        A bounce tells how far a wall extends if it was expected this surely: one detection may be clutter.
    """

    most_turn_rad: float = not_negative(0.3)
    sure_expected: float = probability(0.7)


class UpdateModel(NamedTuple):
    """What the compiled update needs to know, beside gates and limits of branching.

    Parameters
    ----------
    detection_probability : float
        Probability that a visible feature is measured.
    agree_rad, direction_gate_sigma : float
        As in :class:`estimator.slam.models.directions.Directions`.
    most_turn_rad : float
        Largest turn of a wall that is moved along its circle; 0 moves all walls as they are.
    """

    detection_probability: float
    agree_rad: float
    direction_gate_sigma: float
    most_turn_rad: float


class EpochUpdate(NamedTuple):
    """What an epoch does to the hypotheses.

    Parameters
    ----------
    hypotheses : Hypotheses
        Corrected; log weights include the evidence of the epoch and are not normalised.
    parent : ndarray of int64, shape (R,)
        The hypothesis that each comes from.
    detected : ndarray, shape (R, K, F)
        Probability that each feature was measured.
    explained : ndarray, shape (R, K, M)
        Probability that each measurement comes from a feature.
    """

    hypotheses: Hypotheses
    parent: Index
    detected: Array
    explained: Array


@compiled
def _label_sure(gated: GatedPairs, layout: Layout, sure: float, exchange: float) -> Index:
    """The measurement (C,) of each feature that belief propagation does not doubt, -1 for none."""
    label = np.full(gated.anchor.size, -1)
    for k in range(layout.anchors):
        begin, end = gated.begin[k], gated.begin[k + 1]
        if begin == end:
            continue
        ratio = gated.ratio[begin:end]
        probability, message = np.empty(ratio.shape), np.empty(ratio.shape)
        associate(ratio, probability, message)
        found = np.full(end - begin, -1)
        for c in range(end - begin):
            for j in range(ratio.shape[1]):
                if probability[c, j] > sure:
                    found[c] = j
        for c in range(end - begin):
            _, odds = best_exchange(ratio, found, c)
            if odds < exchange:
                label[begin + c] = found[c]
    return label


@compiled
def _take_sure(
    layout: Layout,
    model: UpdateModel,
    range_std_m: float,
    branches: Branches,
    r: int,
    gated: GatedPairs,
    label: Index,
    chance: Array,
    active: Mask,
    paths: EpochPaths,
    clutter: Array,
) -> None:
    """Correct hypothesis ``r`` by the pairs that are beyond doubt; and the silence of all other features."""
    used = np.empty(label.size, dtype=np.int64)
    innovation, variance = np.empty(label.size), np.empty(label.size)
    anchor, feature = np.empty(label.size, dtype=np.int64), np.empty(label.size, dtype=np.int64)
    azimuth, std = np.empty(label.size), np.empty(label.size)
    m = directions = 0
    log_evidence = 0.0
    for c in range(label.size):
        j = label[c]
        if j < 0:
            continue
        k, f = gated.anchor[c], gated.feature[c]
        used[m], innovation[m] = c, gated.innovation_m[c, j]
        variance[m] = path_variance(paths, k, j, range_std_m)
        m += 1
        log_evidence += np.log(max(chance[k, f], 1e-12) / clutter[k])
        branches.detected[r, k, f] = 1.0
        branches.explained[r, k, j] = 1.0
        branches.free[r, k, j] = False
        if np.isfinite(paths.azimuth_std_rad[k, j]):
            anchor[directions], feature[directions] = k, f
            azimuth[directions], std[directions] = paths.azimuth_rad[k, j], paths.azimuth_std_rad[k, j]
            directions += 1
    mean, covariance = branches.mean[r], branches.covariance[r]
    if m:
        used = used[:m]
        log_evidence += joint_update(
            mean,
            covariance,
            taken(gated.position, used),
            taken(gated.value, used),
            taken(gated.entries, used),
            innovation[:m],
            variance[:m],
        )
    for k in range(chance.shape[0]):
        for f in range(chance.shape[1]):
            if chance[k, f] > 0.0 and branches.detected[r, k, f] == 0.0:
                log_evidence += np.log1p(-chance[k, f])
    if directions:
        log_evidence += update_by_directions(
            layout,
            mean,
            covariance,
            sources(layout, mean, active),
            anchor[:directions],
            feature[:directions],
            azimuth[:directions],
            std[:directions],
            paths.heading_held,
            model.agree_rad,
            model.direction_gate_sigma,
        )
    branches.log_evidence[r] = log_evidence


@compiled
def update_hypotheses(
    layout: Layout,
    model: UpdateModel,
    gates: GateModel,
    limits: BranchModel,
    hypotheses: Hypotheses,
    confirmed: Mask,
    owner: Index,
    paths: EpochPaths,
    clutter: Array,
) -> EpochUpdate:
    """Take one epoch of paths into all hypotheses.

    Time is linear in hypotheses, anchors and measurements, and quadratic in walls (their pairs) and in the
    state vector; memory is that of ``most_branches`` hypotheses.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    model, gates, limits : UpdateModel, GateModel, BranchModel
        Models and limits.
    hypotheses : Hypotheses
        Predicted hypotheses.
    confirmed : ndarray of bool, shape (L,)
        Slots that count as found.
    owner : ndarray of int64, shape (L,)
        The anchor of each virtual anchor.
    paths : EpochPaths
        The measurements, azimuths in the gauge frame.
    clutter : ndarray, shape (K,)
        Intensity per metre of paths that no feature gives.
    """
    before = hypotheses.mean
    count, anchors, features = hypotheses.visibility.shape
    measured = paths.length_m.shape[1]
    branches = empty_branches(count, before.shape[1], anchors, features, measured)
    chance = np.zeros((count, anchors, features))
    possible = np.zeros((count, anchors, features), dtype=np.bool_)
    ambiguous, doubtful = np.empty(count, dtype=np.int64), 0
    for r in range(count):
        branches.parent[r] = r
        branches.mean[r] = before[r]
        branches.covariance[r] = hypotheses.covariance[r]
        for k in range(anchors):
            for j in range(paths.number[k]):
                branches.free[r, k, j] = True
        active = active_features(layout, hypotheses.located[r], hypotheses.present[r], confirmed, owner)
        source = sources(layout, before[r], active)
        slanted = path_lengths(layout, before[r], source)
        possible[r] = possible_paths(layout, before[r], source, active)
        for k in range(anchors):
            for f in range(features):
                if possible[r, k, f] and paths.asked[k]:
                    chance[r, k, f] = hypotheses.visibility[r, k, f] * model.detection_probability
        gated = gate(
            layout,
            gates,
            before[r],
            hypotheses.covariance[r],
            source,
            slanted,
            chance[r],
            possible[r],
            branches.free[r],
            paths,
            clutter,
        )
        label = _label_sure(gated, layout, limits.sure_probability, limits.exchange_odds)
        _take_sure(
            layout, model, gates.range_std_m, branches, r, gated, label, chance[r], active, paths, clutter
        )
        moved = branches.mean[r] - before[r]
        left = False
        for c in range(label.size):
            if label[c] < 0 and still_fitting(gates, gated, c, moved, branches.free[r], paths):
                branches.could[r, gated.anchor[c], gated.feature[c]] = True
                left = True
        if left:
            ambiguous[doubtful] = r
            doubtful += 1
    if doubtful:
        weight = hypotheses.log_weight + branches.log_evidence[:count]
        likely = weight > weight.max() - limits.likely_nats
        branches, count = resolve(
            layout, limits, gates, branches, count, ambiguous[:doubtful], likely, chance, paths, clutter
        )
    order = descending(-branches.parent[:count].astype(np.float64))
    parent = taken(branches.parent, order)
    mean, covariance = taken(branches.mean, order), taken(branches.covariance, order)
    detected, explained = taken(branches.detected, order), taken(branches.explained, order)
    visibility = taken(hypotheses.visibility, parent)
    support = taken(hypotheses.support, parent)
    log_weight = taken(hypotheses.log_weight, parent)
    for b in range(count):
        log_weight[b] += branches.log_evidence[order[b]]
    for b in range(count):
        r = parent[b]
        for k in range(anchors):
            for f in range(features):
                if possible[r, k, f] and paths.asked[k]:
                    seen = visibility[b, k, f]
                    missed = 1.0 - seen * model.detection_probability
                    seen = seen * (1.0 - model.detection_probability) / missed
                    visibility[b, k, f] = detected[b, k, f] + (1.0 - detected[b, k, f]) * seen
        for i in range(layout.slots):
            for k in range(anchors):
                if detected[b, k, 1 + i] > 0.5:
                    support[b, i] += 1
                    break
        if layout.shared and model.most_turn_rad > 0.0:
            correct_along_circles(
                layout, before[r], mean[b], covariance[b], hypotheses.located[r], model.most_turn_rad
            )
    corrected = Hypotheses(
        log_weight,
        mean,
        covariance,
        taken(hypotheses.located, parent),
        taken(hypotheses.present, parent),
        visibility,
        support,
    )
    return EpochUpdate(corrected, parent, detected, explained)
