"""Probabilistic data association by loopy belief propagation.

Each feature gives at most one measurement, each measurement comes from at most one
feature (equations (28)-(31)). The iteration is that of J. Williams and R. Lau,
"Approximate evaluation of marginal association probabilities with belief
propagation", IEEE Trans. Aerosp. Electron. Syst. 50(4), 2014; the evidence is the
Bethe approximation at its fixed point, exact where the association graph is a tree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np
from numpy.typing import NDArray

__all__ = ["Association", "associate"]

Array = NDArray[np.float64]
_SETTLED = 1e-6  # relative change of messages


@dataclass(frozen=True, eq=False)
class Association:
    """Marginal association probabilities, from the messages of belief propagation.

    Parameters
    ----------
    weighted : ndarray, shape (..., F, M)
        Ratios, times what the measurements tell the features.
    forth : ndarray, shape (..., F, M)
        What feature ``f`` tells measurement ``j``.
    message : ndarray, shape (..., F, M)
        What measurement ``j`` tells feature ``f``: from 1, the pair is uncontested, to
        0, others claim the measurement.
    """

    weighted: Array
    forth: Array
    message: Array

    @cached_property
    def _total(self) -> Array:
        return np.asarray(1.0 + self.weighted.sum(axis=-1))

    @cached_property
    def probability(self) -> Array:
        """Probability (..., F, M) that feature ``f`` gave measurement ``j``."""
        return np.asarray(self.weighted / self._total[..., None])

    @cached_property
    def log_evidence(self) -> Array:
        """Log (...) of the sum over all associations of the product of their ratios (Bethe approximation)."""
        own, told = np.log(self._total).sum(axis=-1), np.log1p(self.forth.sum(axis=-2)).sum(axis=-1)
        return np.asarray(own + told - np.log1p(self.forth * self.message).sum(axis=(-2, -1)))


def associate(ratio: Array, iterations: int = 12) -> Association:
    """Marginals of a one-to-one association.

    Parameters
    ----------
    ratio : ndarray, shape (..., F, M)
        Likelihood of "feature f gave measurement j" over "feature f was missed and
        measurement j is clutter"; 0 forbids a pair.
    iterations : int
        Rounds of message passing, at least 1; fewer where the messages have settled.

    Returns
    -------
    Association
    """
    graphs = ratio.reshape(prod(ratio.shape[:-2]), *ratio.shape[-2:])
    near = graphs > 0.0
    rows, columns = near.sum(axis=-1), near.sum(axis=-2)
    weighted, forth = graphs, graphs  # of pairs that nothing else claims a part of
    back = 1.0 / (1.0 + (graphs.sum(axis=-2, keepdims=True) - graphs))
    torn = np.flatnonzero((rows.max(axis=-1, initial=0) > 1) | (columns.max(axis=-1, initial=0) > 1))
    if torn.size:
        most = int(np.count_nonzero(rows[torn], axis=1).max())
        weighted, forth = weighted.copy(), forth.copy()
        # features that no measurement is near claim nothing: they are only told at the end
        at = torn[:, None], np.argsort(rows[torn] == 0, axis=1, kind="stable")[:, :most]
        weighted[at], forth[at], told = _messages(graphs[at], iterations)
        back[torn] = 1.0 / (1.0 + forth[torn].sum(axis=-2, keepdims=True))
        back[at] = told
    return Association(*(each.reshape(ratio.shape) for each in (weighted, forth, back)))


def _messages(graphs: Array, iterations: int) -> tuple[Array, Array, Array]:
    """Messages of graphs (N, F, M): weighted ratios, from features to measurements, and back."""
    weighted, forth, back = graphs, graphs, graphs
    left, odds, message = np.arange(len(graphs)), graphs, graphs
    for number in range(iterations):
        to = odds / (1.0 + message.sum(axis=-1, keepdims=True) - message)
        fro = 1.0 / (1.0 + to.sum(axis=-2, keepdims=True) - to)
        before, message = message, odds * fro
        if number == 0:
            weighted, forth, back = message.copy(), to, fro
        else:
            weighted[left], forth[left], back[left] = message, to, fro
        moving = np.any(np.abs(message - before) > _SETTLED * before, axis=(-2, -1))
        if not moving.all():  # a graph rests when its own messages have settled, whatever stands beside it
            left, odds, message = left[moving], odds[moving], message[moving]
            if left.size == 0:
                break
    return weighted, forth, back
