"""A correction moves far walls along circles, not along their tangents.

A path over a wall tells how far its VRP is from the anchor (as long as the agent is near RP): the VRP
lies on a circle round the anchor, and what is known of it is long along the circle and thin across.
A Gaussian in ``x, y`` holds the tangent of that circle. Where later epochs move the VRP by ``s``
along it, the tangent leaves the circle by ``s^2 / 2 r``, which after tens of epochs is many of the thin
standard deviations. So the move is taken in polar coordinates of the anchor: the VRP goes along the
circle, and its errors relative to the anchor turn with it. That is the update of a filter that holds the
walls in such coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["correct_along_circles"]

Array = NDArray[np.float64]


@compiled
def correct_along_circles(
    layout: Layout,
    before: Array,
    mean: Array,
    covariance: Array,
    located: NDArray[np.bool_],
    most_turn_rad: float,
) -> None:
    """Move the walls of a corrected hypothesis along circles round anchors, in place.

    Of several anchors the one that a wall's distance is known best from is its centre. The first wall is the
    gauge's, which does not turn.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    before : ndarray, shape (n,)
        The mean before the correction.
    mean, covariance : ndarray, shapes (n,) and (n, n)
        The corrected Gaussian.
    located : ndarray of bool, shape (K,)
        Anchors that have been located.
    most_turn_rad : float
        A wall that moves by more is moved as it is: a tangent says nothing of such an arc.
    """
    n, anchors = mean.size, layout.anchors
    first_slot = FIRST_ANCHOR + PER_ANCHOR * anchors
    count = max(layout.slots - 1, 0)
    centre = np.full(count, -1)
    cosine, sine = np.ones(count), np.zeros(count)
    for i in range(count):
        w = first_slot + 2 * (i + 1)
        if mean[w] == before[w] and mean[w + 1] == before[w + 1]:
            continue
        least = np.inf
        for k in range(anchors):
            if not located[k]:
                continue
            a = FIRST_ANCHOR + PER_ANCHOR * k
            x, y = mean[w] - mean[a], mean[w + 1] - mean[a + 1]
            square = x * x + y * y
            xx = covariance[w, w] + covariance[a, a] - 2.0 * covariance[w, a]
            yy = covariance[w + 1, w + 1] + covariance[a + 1, a + 1] - 2.0 * covariance[w + 1, a + 1]
            xy = covariance[w, w + 1] + covariance[a, a + 1] - covariance[w, a + 1] - covariance[w + 1, a]
            variance = (x * x * xx + y * y * yy + 2.0 * x * y * xy) / square
            if variance < least:
                least, centre[i] = variance, a
        a = centre[i]
        if a < 0:
            continue
        old_x, old_y = before[w] - before[a], before[w + 1] - before[a + 1]
        new_x, new_y = mean[w] - mean[a], mean[w + 1] - mean[a + 1]
        length = np.sqrt(old_x * old_x + old_y * old_y)
        along = ((new_x - old_x) * old_x + (new_y - old_y) * old_y) / length
        across = ((new_y - old_y) * old_x - (new_x - old_x) * old_y) / length
        if not abs(across) < most_turn_rad * length:
            centre[i] = -1
            continue
        angle = across / length
        cosine[i], sine[i] = np.cos(angle), np.sin(angle)
        radius = length + along
        bend_x, bend_y = radius * (cosine[i] - 1.0), radius * sine[i] - across
        mean[w] += (old_x * bend_x - old_y * bend_y) / length
        mean[w + 1] += (old_y * bend_x + old_x * bend_y) / length
    for i in range(count):  # the rows of the errors relative to the anchor turn
        a = centre[i]
        if a < 0:
            continue
        w, c, s = first_slot + 2 * (i + 1), cosine[i] - 1.0, sine[i]
        for j in range(n):
            x, y = covariance[w, j] - covariance[a, j], covariance[w + 1, j] - covariance[a + 1, j]
            covariance[w, j] += c * x - s * y
            covariance[w + 1, j] += s * x + c * y
    for i in range(count):
        a = centre[i]
        if a < 0:
            continue
        w, c, s = first_slot + 2 * (i + 1), cosine[i] - 1.0, sine[i]
        for j in range(n):
            x, y = covariance[j, w] - covariance[j, a], covariance[j, w + 1] - covariance[j, a + 1]
            covariance[j, w] += c * x - s * y
            covariance[j, w + 1] += s * x + c * y
    for i in range(first_slot, n):  # the two products round differently
        for j in range(n):
            if j < first_slot or j > i:
                mid = 0.5 * (covariance[i, j] + covariance[j, i])
                covariance[i, j] = mid
                covariance[j, i] = mid
