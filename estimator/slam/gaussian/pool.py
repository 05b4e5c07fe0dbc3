"""Rows of several runs in one array.

What is the same for all rows is done for all runs at once; where runs need something of their
own, the pool is taken apart again. Runs of a pool have one layout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimator.slam.gaussian.state import GaussianState, Rows, active_features
from estimator.slam.layout import Layout

__all__ = ["Pool", "active_of", "pending_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pool:
    """The rows of B runs, one run after the other.

    Parameters
    ----------
    rows : Rows
        All rows.
    count : ndarray of int64, shape (B,)
        How many each run has, at least one.
    """

    rows: Rows
    count: NDArray[np.int64]

    @classmethod
    def of(cls, states: Sequence[GaussianState]) -> Pool:
        """The rows of states with one layout."""
        return cls.joined([state.rows for state in states])

    @classmethod
    def joined(cls, rows: Sequence[Rows]) -> Pool:
        """The rows of runs with one layout."""
        count = np.array([len(each) for each in rows])
        if len(rows) == 1:
            return cls(rows[0], count)
        return cls(
            Rows(*(np.concatenate([getattr(each, entry.name) for each in rows]) for entry in fields(Rows))),
            count,
        )

    def take(self, index: NDArray[np.int64]) -> Pool:
        """The rows at ``index``, which keeps the runs in their order, at least one of each."""
        return Pool(self.rows.take(index), np.bincount(self.run[index], minlength=len(self.count)))

    @cached_property
    def begin(self) -> NDArray[np.int64]:
        """First row (B,) of each run."""
        return np.cumsum(self.count) - self.count

    @cached_property
    def run(self) -> NDArray[np.int64]:
        """The run (R,) that each row belongs to."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @property
    def rank(self) -> NDArray[np.int64]:
        """Place (R,) of each row in its run, from 0."""
        return np.arange(len(self.rows)) - self.begin[self.run]

    def apart(self) -> list[Rows]:
        """The rows of each run."""
        if len(self.count) == 1:
            return [self.rows]
        ends = np.cumsum(self.count).tolist()
        return self.rows.parts(list(zip([0, *ends], ends, strict=False)))

    def log_sum_exp(self, values: Array) -> Array:
        """``log(sum(exp(values)))`` (B,) of the rows (R,) of each run."""
        largest = np.maximum.reduceat(values, self.begin)
        total = np.add.reduceat(np.exp(values - largest[self.run]), self.begin)
        return np.asarray(largest + np.log(total))

    def leaders(self) -> Pool:
        """The likeliest row of each run."""
        if len(self.rows) == len(self.count):
            return self
        return Pool(self.rows.take(self.best()), np.ones(len(self.count), dtype=np.int64))

    def best(self) -> NDArray[np.int64]:
        """The likeliest row (B,) of each run."""
        order = np.lexsort((np.arange(len(self.rows)), -self.rows.log_weight, self.run))
        return np.asarray(order[self.begin])


def active_of(pool: Pool, states: Sequence[GaussianState], layout: Layout) -> NDArray[np.bool_]:
    """Features (R, K, F) that each row has (:meth:`estimator.slam.gaussian.state.GaussianState.active`)."""
    confirmed = np.array([state.slots.confirmed for state in states])[pool.run]
    owner = np.array([state.slots.owner for state in states])[pool.run]
    return active_features(pool.rows.located, pool.rows.present, confirmed, owner, layout.shared)


def pending_of(states: Sequence[GaussianState]) -> NDArray[np.bool_]:
    """Which of B runs with one layout have a wall that is not confirmed."""
    wall_id = np.array([state.slots.wall_id for state in states])
    confirmed = np.array([state.slots.confirmed for state in states])
    return np.asarray(np.any((wall_id >= 0) & ~confirmed, axis=1))
