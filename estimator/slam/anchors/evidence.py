"""Log evidence of an anchor at a place, over "all is clutter".

Over a few epochs a feature is visible all along or not at all. Belief propagation between the epochs'
associations tells which: at most E x Q x ``max_gated`` pairs a place, ``ITERATIONS`` rounds of messages each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.likelihood import Gated, Model, Place, gate_epoch, is_behind, walls_between
from estimator.slam.anchors.observations import Observations
from estimator.slam.association.belief_propagation import associate_pairs

__all__ = ["weigh"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def weigh(
    place: Place,
    information: tuple[float, float, float],
    circles: Circles,
    seen: Observations,
    vrp: Array,
    model: Model,
    out: Gated,
) -> tuple[float, int, int]:
    """Log evidence of a place, and the numbers of features of up to one bounce that are explained.

    Parameters
    ----------
    place : Place
        A refined place.
    information : tuple of float
        xx, xy, yy of the information on it: Laplace's approximation integrates over the place.
    circles, seen, vrp, model, out : NamedTuples and arrays
        As for :func:`estimator.slam.anchors.refinement.refine`.

    Returns
    -------
    log_evidence : float
        Over "all is clutter".
    matches : int
        Features that most epochs' paths show.
    fresh : int
        Features that a path of the last epoch shows for sure.
    """
    epochs, features = circles.x.shape
    pd = model.detection_probability
    most = epochs * features * model.max_gated
    start = np.zeros(epochs + 1, dtype=np.int64)
    feature, path, relative = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64), np.empty(most)
    slot = np.zeros(features, dtype=np.int64) - 1  # of the features that any path may show, in order
    shown = np.empty(features, dtype=np.int64)
    active, n, total = 0, 0, 0.0
    silent = (1.0 - pd) ** epochs
    behind = np.zeros(features, dtype=np.bool_)
    for q in range(1, 1 + circles.walls):
        behind[q] = is_behind(place.x, place.y, vrp[q - 1, 0], vrp[q - 1, 1])
    for e in range(epochs):
        if gate_epoch(place, circles, seen, e, 0, features, vrp, model, out):
            for q in range(features):
                if out.begin[q] < out.begin[q + 1] and slot[q] < 0:
                    slot[q] = active
                    shown[active] = q
                    active += 1
                for i in range(out.begin[q], out.begin[q + 1]):
                    feature[n], path[n], relative[n] = slot[q], out.path[i], out.relative[i]
                    n += 1
        start[e + 1] = n
    for q in range(features):
        if slot[q] < 0 and not behind[q]:
            total += np.log(1.0 - model.visibility[q] + model.visibility[q] * silent)
    prior = np.empty(active)
    for f in range(active):
        prior[f] = model.visibility[shown[f]]
    log_ratio = np.zeros((epochs, active))  # of being visible, over not
    contest, often, sure = np.zeros(epochs), np.zeros(active), np.zeros(active)
    odds, forth, back, told, mass = np.empty(n), np.empty(n), np.empty(n), np.empty(active), np.empty(active)
    last = min(epochs, 2) - 1
    for sweep in range(last + 1):
        for e in range(epochs):
            begin, end = start[e], start[e + 1]
            for f in range(active):
                others = 0.0
                for other in range(epochs):
                    if other != e:
                        others += log_ratio[other, f]
                visible = prior[f] / (prior[f] + (1.0 - prior[f]) * np.exp(-min(max(others, -50.0), 50.0)))
                told[f] = pd * visible / (1.0 - pd * visible)
            for i in range(begin, end):
                odds[i] = told[feature[i]] * relative[i]
            by_path = np.empty(seen.paths[e])
            associate_pairs(
                odds[begin:end],
                feature[begin:end],
                path[begin:end],
                forth[begin:end],
                back[begin:end],
                mass,
                by_path,
            )
            contest[e] = 0.0  # Bethe's evidence less that of the features each on its own
            for j in range(seen.paths[e]):
                if by_path[j] > 0.0:
                    contest[e] += np.log1p(by_path[j])
            for i in range(begin, end):
                contest[e] -= np.log1p(forth[i] * back[i])
            told[:] = 0.0
            for i in range(begin, end):
                told[feature[i]] += relative[i] * back[i]
            for f in range(active):
                log_ratio[e, f] = np.log(1.0 - pd + pd * told[f])
            if sweep == last:
                for i in range(begin, end):
                    probability = odds[i] * back[i] / (1.0 + mass[feature[i]])
                    often[feature[i]] += probability / epochs
                    if e == epochs - 1:
                        sure[feature[i]] = max(sure[feature[i]], probability)
    matches, fresh = 0, 0
    for f in range(active):
        ratio = 0.0
        for e in range(epochs):
            ratio += log_ratio[e, f]
        total += np.log(1.0 - prior[f] + prior[f] * np.exp(min(ratio, 300.0)))
        if shown[f] <= circles.walls:
            matches += 1 if often[f] > 0.5 else 0
            fresh += 1 if sure[f] > model.fresh_probability else 0
    for e in range(epochs):
        total += contest[e]
    total += model.behind_wall_log_prior * walls_between(place.x, place.y, vrp)
    determinant = information[0] * information[2] - information[1] * information[1]
    area = np.pi * model.region_m**2  # the prior, and Laplace's approximation of the integral
    total += np.log(2.0 * np.pi / area) - 0.5 * np.log(determinant)
    return total, matches, fresh
