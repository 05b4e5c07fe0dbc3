"""Two features near the same two paths: how likely it is that they are exchanged.

On a cycle of two features and two measurements belief propagation counts the evidence twice: odds of
ten to one become hundred to one. Just there, where two paths cross, the exchange is a matter of four ratios.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["exchange_odds", "with_exchange"]

Array = NDArray[np.float64]


def exchange_odds(ratio: Array, label: NDArray[np.int64]) -> Array:
    """Odds (..., F, F) that two features exchange their measurements, over that they keep them.

    Parameters
    ----------
    ratio : ndarray, shape (..., F, M)
        As for :func:`estimator.slam.association.associate`.
    label : ndarray of int64, shape (..., F)
        The measurement that each feature has, -1 for none.
    """
    odds = np.zeros((*label.shape, label.shape[-1]))
    some = np.any(np.count_nonzero(ratio, axis=-1) > 1, axis=-1)  # else no feature fits two
    if not some.any():
        return odds
    ratio, label = ratio[some], label[some]
    graph, feature = np.arange(len(label))[:, None, None], np.arange(label.shape[-1])
    others = ratio[graph, feature[:, None], np.maximum(label, 0)[:, None]]  # with the others' paths
    own = np.where(label >= 0, others[:, feature, feature], np.inf)
    exchanged = others * others.transpose(0, 2, 1) / (own[:, :, None] * own[:, None])
    exchanged[:, feature, feature] = 0.0
    odds[some] = exchanged
    return odds


def with_exchange(share: Array, ratio: Array) -> Array:
    """Association probabilities (..., F, M) of belief propagation, with what exchanges leave of them.

    Of each feature's exchanges the likeliest counts.
    """
    if share.shape[-2] < 2:
        return share
    label = np.where(share.max(axis=-1, initial=0.0) > 0.5, np.argmax(share, axis=-1), -1)
    odds = exchange_odds(ratio, label)
    if not odds.any():
        return share
    partner = np.argmax(odds, axis=-1)
    chance = np.take_along_axis(odds, partner[..., None], axis=-1)[..., 0]
    chance = chance / (1.0 + chance)
    some = np.nonzero(chance > 0.0)
    if some[0].size == 0:
        return share
    share = share.copy()
    mine, other = label[some], label[(*some[:-1], partner[some])]
    total = share[(*some, mine)] + share[(*some, other)]
    swapped = np.maximum(share[(*some, other)], total * chance[some])
    share[(*some, other)], share[(*some, mine)] = swapped, total - swapped
    return share
