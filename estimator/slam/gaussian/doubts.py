"""The paths of an epoch that might have come another way: rows split, or blur.

A doubt whose alternatives would move a row far apart, against the uncertainty that each would leave, is
decided every way: one row per alternative. The alternative is taken at once, and what is left predicted
and associated again: where one cause moves all features alike (the agent's first step, of unknown speed),
the next doubt is judged by what this one told, and the rows' evidence is that of their paths together. What
would hardly move a row is taken by its probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from estimator.slam.association import associate
from estimator.slam.features import predict_paths
from estimator.slam.gaussian.hearing import Hearing, Near, take
from estimator.slam.gaussian.swaps import with_exchange

__all__ = ["Doubts", "settle"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
_APART = 0.5  # a row splits if the alternatives move it by more than this many standard deviations
_SPLITS = 3  # doubts of one epoch that a row splits for,
_FEW_ROWS, _MANY_ROWS = 64, 256  # or one if its run has more rows than these; a likely row, than those
_LEAST_CHANCE = 1e-3  # of an alternative worth a row,
_MOST_CHANCES = 30  # of which a doubt has at most so many


@dataclass(frozen=True, eq=False)
class Doubts:
    """Rows with measurements that are in doubt.

    Parameters
    ----------
    parent, run : ndarray of int64, shape (S,)
        The row that each comes from, and the run it belongs to.
    likely : ndarray of bool, shape (S,)
        Rows that split among more rows than the others do.
    mean, covariance : ndarray, shapes (S, n) and (S, n, n)
        Their Gaussians.
    chance : ndarray, shape (S, K, F)
        Probability that each feature is measured.
    could : ndarray of bool, shape (S, K, F)
        Features that may have given one of the measurements
    free : ndarray of bool, shape (S, K, M)
        that are left.
    heard, explained : ndarray, shapes (S, K, F) and (S, K, M)
        Probability that each feature was measured, and that each measurement is from one.
    log_evidence : ndarray, shape (S,)
        Log evidence of what was taken over "all is clutter", the silence of the others left out.
    """

    parent: Index
    run: Index
    likely: Mask
    mean: Array
    covariance: Array
    chance: Array
    could: Mask
    free: Mask
    heard: Array
    explained: Array
    log_evidence: Array

    def __len__(self) -> int:
        return len(self.parent)

    def of_rows(self, index: Index) -> Doubts:
        """Copies of the rows at ``index``."""
        return Doubts(*(getattr(self, entry.name)[index] for entry in fields(self)))


def settle(doubts: Doubts, epoch: Hearing, size: Index) -> Doubts:
    """Take all that is left of an epoch, and split the rows that would blur.

    Parameters
    ----------
    doubts : Doubts
        Rows with doubts, in any order.
    epoch : Hearing
        What the epoch brings to them.
    size : ndarray of int64
        How many rows each run has, those without doubts included.

    Returns
    -------
    Doubts
        Rows in the order of their parents.
    """
    done: list[Doubts] = []
    for turn in range(_SPLITS + 1):
        prediction = predict_paths(doubts.mean, epoch.layout)
        near = epoch.near(
            doubts.mean, doubts.covariance, prediction, doubts.chance, doubts.could, doubts.free
        )
        association = associate(near.ratio)
        share, evidence = with_exchange(association.probability, near.ratio), association.log_evidence
        harm = _harm(share, near, epoch)
        torn = (harm.max(axis=(1, 2), initial=0.0) >= _APART**2) & (turn < _SPLITS)
        torn &= (turn == 0) | (size[doubts.run] <= np.where(doubts.likely, _MANY_ROWS, _FEW_ROWS))
        if not torn.any():
            done.append(_blurred(doubts, near, share, evidence, epoch))
            break
        calm = np.flatnonzero(~torn)
        if calm.size:
            done.append(
                _blurred(
                    doubts.of_rows(calm), near.of_rows(calm), share[calm], evidence[calm], epoch.of_rows(calm)
                )
            )
        row, *way = _ways(share, harm, torn)
        size = size + np.bincount(doubts.run[row], minlength=len(size))
        size = size - np.bincount(doubts.run[torn], minlength=len(size))
        epoch = epoch.of_rows(row)
        doubts = _decided(doubts.of_rows(row), near.of_rows(row), way, epoch)
    columns = [np.concatenate([getattr(part, entry.name) for part in done]) for entry in fields(Doubts)]
    return Doubts(*columns).of_rows(np.argsort(columns[0], kind="stable"))


def _harm(share: Array, near: Near, epoch: Hearing) -> Array:
    """Scatter (S, K, C) that the alternatives of each feature give a row, over the variance they leave."""
    noise = epoch.variance[:, :, None, :]
    s = near.spread[..., None] + noise
    shift = near.spread[..., None] / s * near.innovation
    first = np.sum(share * shift, axis=-1)
    scatter = np.sum(share * shift**2, axis=-1) - first**2
    left = np.maximum(np.min(near.spread[..., None] * noise / s, axis=-1), 1e-8)
    return np.asarray(scatter / left)


def _ways(share: Array, harm: Array, torn: Mask) -> tuple[Index, Index, Index, Index]:
    """The alternatives of the most harmful doubt of each row that is ``torn`` (S,).

    Returns
    -------
    row, anchor, column, path : ndarray of int64, shape (D,)
        The row of each alternative, its feature, and the measurement that this gave, -1 for none.
    """
    rows = np.flatnonzero(torn)
    anchor, column = np.unravel_index(np.argmax(harm[rows].reshape(rows.size, -1), axis=1), harm.shape[1:])
    chances = share[rows, anchor, column]
    chances = np.concatenate([chances, np.maximum(1.0 - chances.sum(axis=1, keepdims=True), 0.0)], axis=1)
    rank = np.argsort(np.argsort(-chances, axis=1, kind="stable"), axis=1)
    which, path = np.nonzero((rank < _MOST_CHANCES) & ((chances > _LEAST_CHANCE) | (rank == 0)))
    path = np.where(path == share.shape[-1], -1, path)
    return rows[which], anchor[which], column[which], path


def _decided(doubts: Doubts, near: Near, way: list[Index], epoch: Hearing) -> Doubts:
    """Rows with one alternative each taken: a feature's measurement, or that it gave none."""
    anchor, column, path = way
    row = np.arange(len(doubts))
    feature = near.feature[row, anchor, column]
    doubts.could[row, anchor, feature] = False
    row = np.flatnonzero(path >= 0)
    anchor, column, path, feature = anchor[row], column[row], path[row], feature[row]
    doubts.log_evidence[row] += np.log(near.ratio[row, anchor, column, path])
    doubts.heard[row, anchor, feature] = 1.0
    doubts.explained[row, anchor, path] = 1.0
    doubts.free[row, anchor, path] = False
    use = np.zeros(near.feature.shape, dtype=bool)
    innovation, variance = np.zeros(use.shape), np.ones(use.shape)
    use[row, anchor, column] = True
    innovation[row, anchor, column] = near.innovation[row, anchor, column, path]
    noise = np.broadcast_to(epoch.variance, doubts.free.shape)
    variance[row, anchor, column] = noise[row, anchor, path]
    mean, covariance, _ = take(doubts.mean, doubts.covariance, near, innovation, variance, use)
    return replace(doubts, mean=mean, covariance=covariance)


def _blurred(doubts: Doubts, near: Near, share: Array, log_evidence: Array, epoch: Hearing) -> Doubts:
    """Rows corrected by all that is left at once, by its probabilities (S, K, C, M) and evidence (S, K)."""
    layout = epoch.layout
    heard = share.sum(axis=-1)
    weight = np.maximum(heard, 1e-12)
    expected = np.sum(share * near.innovation, axis=-1) / weight
    second = (
        np.sum(share * (near.innovation**2 + epoch.variance[:, :, None, :]), axis=-1) / weight - expected**2
    )
    soft = heard > 0.05
    if layout.pairs:
        soft &= (near.feature <= layout.slots) | (near.spread < epoch.config.pair_std_m**2)
    mean, covariance, _ = take(doubts.mean, doubts.covariance, near, expected, second / weight, soft)
    everywhere = doubts.heard.copy()
    everywhere[(*np.nonzero(near.real)[:2], near.feature[near.real])] = heard[near.real]
    return replace(
        doubts,
        mean=mean,
        covariance=covariance,
        heard=everywhere,
        explained=np.maximum(doubts.explained, share.sum(axis=-2)),
        log_evidence=doubts.log_evidence + log_evidence.sum(axis=-1),
    )
