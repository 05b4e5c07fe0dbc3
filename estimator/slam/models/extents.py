"""Observed extents: where along a wall reflections were detected, and from where."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.features import mirror, side_of_wall
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["bounce_along_wall", "widen_extents"]

Array = NDArray[np.float64]


@compiled
def bounce_along_wall(px: float, py: float, ax: float, ay: float, vx: float, vy: float) -> float:
    """Where along a wall the bounce from ``a`` to ``p`` lies: signed distance from the foot of RP, metres."""
    ix, iy = mirror(ax, ay, vx, vy)
    here, there = side_of_wall(px, py, vx, vy), side_of_wall(ix, iy, vx, vy)
    fraction = here / (here - there) if here != there else 0.0
    size = np.sqrt(vx * vx + vy * vy)
    before, after = (py * vx - px * vy) / size, (iy * vx - ix * vy) / size
    return float(before + fraction * (after - before))


@compiled
def widen_extents(
    layout: Layout, mean: Array, detected: Array, extent: Array, detected_from: Array
) -> tuple[Array, Array]:
    """Extents and places after what the likeliest hypothesis detected in this epoch.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean : ndarray, shape (n,)
        Its mean.
    detected : ndarray, shape (K, F)
        Probability that each feature was measured; above one half counts.
    extent : ndarray, shape (L, 2)
        Extents before, metres along the walls.
    detected_from : ndarray, shape (L, K, 2, 2)
        Where the agent was when it first and last detected each anchor over the wall; NaN before.
    """
    extent, detected_from = extent.copy(), detected_from.copy()
    first_slot = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    for k in range(layout.anchors):
        a = FIRST_ANCHOR + PER_ANCHOR * k
        for i in range(layout.slots):
            if not detected[k, 1 + i] > 0.5:
                continue
            for c in range(2):
                if np.isnan(detected_from[i, k, 0, c]):
                    detected_from[i, k, 0, c] = mean[c]
                detected_from[i, k, 1, c] = mean[c]
            if layout.shared:
                w = first_slot + 2 * i
                along = bounce_along_wall(mean[0], mean[1], mean[a], mean[a + 1], mean[w], mean[w + 1])
                extent[i, 0] = min(extent[i, 0], along)
                extent[i, 1] = max(extent[i, 1], along)
    return extent, detected_from
