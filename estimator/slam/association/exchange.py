"""Two features near the same two paths: how likely it is that they are exchanged.

On a cycle of two features and two measurements belief propagation counts the evidence twice: odds of
ten to one become hundred to one. Just there, where two paths cross, the exchange is a matter of four ratios.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["best_exchange", "with_exchange"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def best_exchange(ratio: Array, label: Index, f: int) -> tuple[int, float]:
    """The feature that ``f`` most likely exchanges its measurement with, and the odds that it does.

    Parameters
    ----------
    ratio : ndarray, shape (F, M)
        As for :func:`estimator.slam.association.belief_propagation.associate`.
    label : ndarray of int64, shape (F,)
        The measurement that each feature has, -1 for none.
    f : int
        A feature.

    Returns
    -------
    partner : int
        The other feature, -1 if no exchange is possible.
    odds : float
        Of the exchange over that both keep what they have.
    """
    partner, best = -1, 0.0
    mine = label[f]
    if mine < 0:
        return partner, best
    for g in range(label.size):
        other = label[g]
        if g == f or other < 0:
            continue
        odds = ratio[f, other] * ratio[g, mine] / (ratio[f, mine] * ratio[g, other])
        if odds > best:
            partner, best = g, odds
    return partner, best


@compiled
def with_exchange(probability: Array, ratio: Array) -> None:
    """Correct probabilities (F, M) of belief propagation, in place, by what exchanges leave of them.

    Of each feature's exchanges the likeliest counts.
    """
    features, measurements = probability.shape
    if features < 2:
        return
    label = np.full(features, -1)
    for f in range(features):
        for j in range(measurements):
            if probability[f, j] > 0.5:
                label[f] = j
    for f in range(features):
        partner, odds = best_exchange(ratio, label, f)
        if partner < 0:
            continue
        mine, other = label[f], label[partner]
        total = probability[f, mine] + probability[f, other]
        exchanged = max(probability[f, other], total * odds / (1.0 + odds))
        probability[f, other], probability[f, mine] = exchanged, total - exchanged
