"""Hypotheses that have located an anchor: one of each old one, place and labelling of the present paths.

Neither the candidates' covariances are believed nor their labels: both come from walls held fixed. The
anchor starts wide, and the present paths enter the joint Gaussian, where anchor and walls become correlated,
once for each labelling. Earlier epochs only chose the place; their lengths are not used as information
again.

At most ``max_labelled`` triples are weighed, of the likeliest ``max_branches`` hypotheses and the best
places first, and at most ``max_branches`` of the best become hypotheses; most others would not survive the
mixture reduction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.joint_update import (
    BranchLimits,
    PlacePaths,
    updated,
    weigh_labellings,
)
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.state_vector import Layout

__all__ = ["branch_hypotheses"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def branch_hypotheses(
    hypotheses: Hypotheses,
    members: Index,
    layout: Layout,
    anchor: int,
    places: PlacePaths,
    anchor_std_m: float,
    height2: tuple[float, float],
    fresh_visibility: Array,
    limits: BranchLimits,
) -> Hypotheses:
    """New hypotheses in which ``anchor`` is located.

    Parameters
    ----------
    hypotheses : Hypotheses
        All of the state: none is made that is ``prune_nats`` below the best of these.
    members : ndarray of int64
        Those that branch; all or none of them have located the anchor.
    layout : Layout
        Positions in the state vector.
    anchor : int
        The anchor.
    places : PlacePaths
        Where it may be.
    anchor_std_m : float
        Standard deviation per axis that it starts with, metres.
    height2 : tuple of float
        Mean and standard deviation of the squared height of an anchor that was located elsewhere, square
        metres.
    fresh_visibility : ndarray, shape (F,)
        Prior visibility of its features.
    limits : BranchLimits
        Bounds.

    Returns
    -------
    Hypotheses
        Possibly none.
    """
    order = np.argsort(-hypotheses.log_weight[members], kind="stable")
    base = hypotheses.take(members[order[: limits.max_branches]])
    xy, w = layout.anchor_xy(anchor), layout.height2(anchor)
    if base.located[:, anchor].any():  # what was known of the anchor goes with its place
        known = slice(xy.start, w + 1)
        base.covariance[:, known, :] = 0.0
        base.covariance[:, :, known] = 0.0
        base.mean[:, w], base.covariance[:, w, w] = height2[0], height2[1] ** 2
    base.covariance[:, xy, xy] = anchor_std_m**2 * np.eye(2)
    row, child, weight = _children(base, layout, anchor, places, float(hypotheses.log_weight.max()), limits)
    mean, covariance = updated(layout, anchor, base.mean, base.covariance, places, row, child)
    new = base._replace(covariance=base.covariance[:, :0, :0]).take(row)  # the covariances are made already
    new.located[:, anchor] = True
    new.visibility[:, anchor] = fresh_visibility
    return new._replace(log_weight=weight, mean=mean, covariance=covariance)


def _children(
    base: Hypotheses, layout: Layout, anchor: int, places: PlacePaths, best: float, limits: BranchLimits
) -> tuple[Index, Index, Array]:
    """Hypothesis, labelling and log weight of the children that are made, the likeliest first."""
    bound = base.log_weight[:, None] + places.log_evidence
    order = np.argsort(-bound, axis=None, kind="stable")
    weight = np.full((base.number, len(places.label)), -np.inf)
    weigh_labellings(
        layout, anchor, base.log_weight, base.mean, base.covariance, places, order, best, limits, weight
    )
    row, child = np.nonzero(weight > max(best, float(weight.max(initial=-np.inf))) - limits.prune_nats)
    made = weight[row, child]
    chosen = np.argsort(-made, kind="stable")[: limits.max_branches]
    return row[chosen], child[chosen], made[chosen]
