"""Hypotheses of an epoch while its measurements are taken: arrays that grow as hypotheses branch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["Branches", "copy_branch", "empty_branches", "room_for"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


class Branches(NamedTuple):
    """Hypotheses of an epoch while its measurements are taken; arrays have room for more than there are.

    Parameters
    ----------
    parent : ndarray of int64, shape (B,)
        The hypothesis before the epoch that each comes from.
    mean, covariance : ndarray, shapes (B, n) and (B, n, n)
        Their Gaussians.
    detected : ndarray, shape (B, K, F)
        Probability that each feature was measured.
    explained : ndarray, shape (B, K, M)
        Probability that each measurement comes from a feature.
    free : ndarray of bool, shape (B, K, M)
        Measurements that have not been taken.
    could : ndarray of bool, shape (B, K, F)
        Features that may have given one of them.
    log_evidence : ndarray, shape (B,)
        Log evidence of the epoch over "all is clutter".
    """

    parent: Index
    mean: Array
    covariance: Array
    detected: Array
    explained: Array
    free: Mask
    could: Mask
    log_evidence: Array


@compiled
def empty_branches(count: int, size: int, anchors: int, features: int, paths: int) -> Branches:
    """Room for so many hypotheses."""
    return Branches(
        np.empty(count, dtype=np.int64),
        np.empty((count, size)),
        np.empty((count, size, size)),
        np.zeros((count, anchors, features)),
        np.zeros((count, anchors, paths)),
        np.zeros((count, anchors, paths), dtype=np.bool_),
        np.zeros((count, anchors, features), dtype=np.bool_),
        np.zeros(count),
    )


@compiled
def room_for(branches: Branches, needed: int) -> Branches:
    """The same hypotheses with room for ``needed`` and as many again."""
    have, size = branches.mean.shape
    if needed <= have:
        return branches
    anchors, features = branches.detected.shape[1], branches.detected.shape[2]
    more = empty_branches(2 * needed, size, anchors, features, branches.explained.shape[2])
    more.parent[:have] = branches.parent
    more.mean[:have] = branches.mean
    more.covariance[:have] = branches.covariance
    more.detected[:have] = branches.detected
    more.explained[:have] = branches.explained
    more.free[:have] = branches.free
    more.could[:have] = branches.could
    more.log_evidence[:have] = branches.log_evidence
    return more


@compiled
def copy_branch(branches: Branches, source: int, target: int) -> None:
    """Make hypothesis ``target`` what ``source`` is."""
    branches.parent[target] = branches.parent[source]
    branches.mean[target] = branches.mean[source]
    branches.covariance[target] = branches.covariance[source]
    branches.detected[target] = branches.detected[source]
    branches.explained[target] = branches.explained[source]
    branches.free[target] = branches.free[source]
    branches.could[target] = branches.could[source]
    branches.log_evidence[target] = branches.log_evidence[source]
