"""Least squares for the place of an anchor: Gauss-Newton on the likeliest path of each circle.

At most ``ITERATIONS`` times E x Q circles a place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.likelihood import Model, Place, expected_length, gate_circle, is_behind
from estimator.slam.anchors.observations import Observations

__all__ = ["refine"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
ITERATIONS = 6  # of Gauss-Newton, at most
_STILL_M = 1e-4  # numerical tolerance: a place that moves by less has been found
_FLAT = 1e-4  # numerical floor of the information, per square metre


@compiled
def refine(
    place: Place, circles: Circles, seen: Observations, widest: Array, vrp: Array, model: Model
) -> tuple[float, float, float, float, float]:
    """The place that fits its paths best, x and y, and the information xx, xy, yy that they give on it.

    Parameters
    ----------
    place : Place
        Where to begin.
    circles, seen, widest : Circles, Observations, ndarray of shape (E,)
        Circles and paths of all epochs, and the largest variance of each epoch's paths.
    vrp : ndarray, shape (L, 2)
        Walls.
    model : Model
        Numbers.
    """
    path, relative = np.empty(model.max_gated, dtype=np.int64), np.empty(model.max_gated)
    x, y, xx, xy, yy = place.x, place.y, 0.0, 0.0, 0.0
    for _ in range(ITERATIONS):
        at = Place(x, y, place.bias, place.height2)
        gx, gy, xx, xy, yy = 0.0, 0.0, _FLAT, 0.0, _FLAT
        for q in range(circles.x.shape[1]):
            if 0 < q <= circles.walls and is_behind(x, y, vrp[q - 1, 0], vrp[q - 1, 1]):
                continue
            kind = 0 if q == 0 else (1 if q <= circles.walls else 2)
            chance = model.visibility[kind] * model.detection_probability
            for e in range(len(circles.x)):
                count = gate_circle(at, circles, seen, widest, e, q, model, path, relative)
                if count == 0:
                    continue
                best = int(np.argmax(relative[:count]))
                expected, ux, uy, variance = expected_length(at, circles, e, q)
                odds = chance / (1.0 - chance) * relative[best]
                weight = odds / (1.0 + odds) / (variance + seen.length_variance_m2[e, path[best]])
                pull = weight * (seen.length_m[e, path[best]] - expected)
                gx, gy = gx + pull * ux, gy + pull * uy
                xx, xy, yy = xx + weight * ux * ux, xy + weight * ux * uy, yy + weight * uy * uy
        determinant = xx * yy - xy * xy
        dx, dy = (yy * gx - xy * gy) / determinant, (xx * gy - xy * gx) / determinant
        x, y = x + dx, y + dy
        if not dx * dx + dy * dy > _STILL_M * _STILL_M:
            break
    return x, y, xx, xy, yy
