"""Least squares for the place of an anchor: Gauss-Newton on the likeliest path of each circle.

At most ``ITERATIONS`` times E x Q circles a place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.likelihood import Gated, Model, Place, gate_epoch
from estimator.slam.anchors.observations import Observations

__all__ = ["refine"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
ITERATIONS = 6  # of Gauss-Newton, at most
_STILL_M = 1e-4  # numerical tolerance: a place that moves by less has been found
_FLAT = 1e-4  # numerical floor of the information, per square metre


@compiled
def refine(
    place: Place, circles: Circles, seen: Observations, vrp: Array, model: Model, out: Gated
) -> tuple[float, float, float, float, float]:
    """The place that fits its paths best, x and y, and the information xx, xy, yy that they give on it.

    Parameters
    ----------
    place : Place
        Where to begin.
    circles, seen : Circles, Observations
        Circles and paths of all epochs.
    vrp : ndarray, shape (L, 2)
        Walls.
    model : Model
        Numbers.
    out : Gated
        Room to work in.
    """
    x, y, xx, xy, yy = place.x, place.y, 0.0, 0.0, 0.0
    for _ in range(ITERATIONS):
        at = Place(x, y, place.bias, place.height2, place.height2_std)
        gx, gy, xx, xy, yy = 0.0, 0.0, _FLAT, 0.0, _FLAT
        for e in range(len(circles.x)):
            if gate_epoch(at, circles, seen, e, 0, circles.x.shape[1], vrp, model, out) == 0:
                continue
            for q in range(circles.x.shape[1]):
                begin, end = out.begin[q], out.begin[q + 1]
                if begin == end:
                    continue
                best = begin
                for i in range(begin + 1, end):
                    if out.relative[i] > out.relative[best]:
                        best = i
                chance = model.visibility[q] * model.detection_probability
                odds = chance / (1.0 - chance) * out.relative[best]
                weight = odds / (1.0 + odds) * out.information[best]
                pull, ux, uy = weight * out.residual[best], out.ux[q], out.uy[q]
                gx, gy = gx + pull * ux, gy + pull * uy
                xx, xy, yy = xx + weight * ux * ux, xy + weight * ux * uy, yy + weight * uy * uy
        determinant = xx * yy - xy * xy
        dx, dy = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
        x, y = x + dx, y + dy
        if not dx * dx + dy * dy > _STILL_M * _STILL_M:
            break
    return x, y, xx, xy, yy
