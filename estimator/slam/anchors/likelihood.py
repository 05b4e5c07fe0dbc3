"""Which paths an anchor at a place would explain: gated pairs of circles and paths, and their likelihoods.

Per place and epoch at most ``max_gated`` pairs a circle; paths are sorted by length, so that a pair is found
by bisection and what is far costs nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.observations import NoiseModel, Observations

__all__ = ["Gated", "Model", "Place", "gate_epoch", "is_behind", "model_of", "room_for", "walls_between"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Model(NamedTuple):
    """Numbers of the likelihood that compiled functions take.

    Parameters
    ----------
    detection_probability : float
        That a visible feature is measured.
    clutter_density : float
        Clutter, per metre.
    gate_sigma : float
        Gate, standard deviations.
    visibility : ndarray, shape (Q,)
        Prior probability that the path of each circle is there.
    fresh_probability, behind_wall_log_prior : float
        As in :class:`AnchorSearchConfig`.
    region_m : float
        Largest path length: anchors are uniform in a circle of this radius, metres.
    max_gated : int
        Most paths that may explain one circle.
    """

    detection_probability: float
    clutter_density: float
    gate_sigma: float
    visibility: Array
    fresh_probability: float
    behind_wall_log_prior: float
    region_m: float
    max_gated: int


def model_of(circles: Circles, noise: NoiseModel, config: AnchorSearchConfig) -> Model:
    """The numbers of a noise model and a configuration."""
    prior = config.search_visibility_los, config.search_visibility_wall, config.search_visibility_pair
    count = 1, circles.walls, circles.x.shape[1] - 1 - circles.walls
    return Model(
        float(noise.detection_probability),
        float(noise.clutter_density),
        float(config.search_gate_sigma),
        np.repeat(prior, count),
        float(config.fresh_probability),
        float(config.behind_wall_log_prior),
        float(noise.region_m),
        int(config.max_gated),
    )


class Place(NamedTuple):
    """Where an anchor may stand, and what is off its path lengths.

    Parameters
    ----------
    x, y : float
        Place, metres.
    bias : float
        Clock bias, metres.
    height2, height2_std : float
        Squared height difference and its standard deviation, square metres.
    """

    x: float
    y: float
    bias: float
    height2: float
    height2_std: float


class Gated(NamedTuple):
    """Room for the gated pairs of a place and an epoch, Q circles and N pairs at most.

    Parameters
    ----------
    begin : ndarray of int64, shape (Q + 1,)
        The pairs of circle ``q`` are ``begin[q]`` to ``begin[q + 1]``.
    path : ndarray of int64, shape (N,)
        Their paths.
    relative : ndarray, shape (N,)
        Their likelihoods over clutter's.
    residual, information : ndarray, shape (N,)
        Length beyond the expected one, metres, and one over its variance.
    expected : ndarray, shape (Q,)
        Expected lengths, metres.
    ux, uy : ndarray, shape (Q,)
        Derivative of the expected length by the place; of circles that have pairs.
    """

    begin: Index
    path: Index
    relative: Array
    residual: Array
    information: Array
    expected: Array
    ux: Array
    uy: Array


@compiled
def room_for(circles: int, most: int) -> Gated:
    """Room for the pairs of so many circles, ``most`` each."""
    size = circles * most
    begin, path = np.zeros(circles + 1, dtype=np.int64), np.empty(size, dtype=np.int64)
    relative, residual, information = np.empty(size), np.empty(size), np.empty(size)
    expected, ux, uy = np.empty(circles), np.empty(circles), np.empty(circles)
    return Gated(begin, path, relative, residual, information, expected, ux, uy)


@compiled
def is_behind(x: float, y: float, vx: float, vy: float) -> bool:
    """Whether a place is not on RP's side of the wall of a VRP."""
    return bool(2.0 * (x * vx + y * vy) >= vx * vx + vy * vy)


@compiled
def walls_between(x: float, y: float, vrp: Array) -> int:
    """Number of the walls (L, 2) behind which a place stands."""
    behind = 0
    for w in range(len(vrp)):
        if is_behind(x, y, vrp[w, 0], vrp[w, 1]):
            behind += 1
    return behind


@compiled
def gate_epoch(
    place: Place,
    circles: Circles,
    seen: Observations,
    e: int,
    first: int,
    last: int,
    vrp: Array,
    model: Model,
    out: Gated,
) -> int:
    """The paths of epoch ``e`` that circles ``first`` to ``last`` may explain, put into ``out``; how many.

    A circle over a wall (L, 2) behind which the place stands explains none.
    """
    count, paths, gate2 = 0, seen.paths[e], model.gate_sigma * model.gate_sigma
    scale = 1.0 / (np.sqrt(2.0 * np.pi) * model.clutter_density)
    x, y, expected, last_bucket = circles.x[e], circles.y[e], out.expected, seen.first.shape[1] - 1
    for q in range(first, last):
        dx, dy = place.x - x[q], place.y - y[q]
        expected[q] = place.bias + max(np.sqrt(dx * dx + dy * dy + place.height2), 1e-6)
    for q in range(first, last):
        out.begin[q] = count
        inverse = 1.0 / (expected[q] - place.bias)
        height_std = 0.5 * place.height2_std * inverse
        reach = circles.reach_m[e, q] + model.gate_sigma * height_std
        low_m, high_m = expected[q] - reach, expected[q] + reach
        low = seen.first[e, int(min(max(low_m * seen.buckets_per_m, 0.0), last_bucket))]
        while low < paths and seen.length_m[e, low] < low_m:
            low += 1
        if low == paths or seen.length_m[e, low] > high_m:
            continue
        if 0 < q <= circles.walls and is_behind(place.x, place.y, vrp[q - 1, 0], vrp[q - 1, 1]):
            continue
        high = low + 1
        while high < paths and seen.length_m[e, high] <= high_m:
            if high - low < model.max_gated:
                high += 1
            elif expected[q] - seen.length_m[e, low] > seen.length_m[e, high] - expected[q]:
                low, high = low + 1, high + 1  # keep those nearest to the expected length
            else:
                break
        ux, uy = (place.x - x[q]) * inverse, (place.y - y[q]) * inverse
        spread = ux * (ux * circles.xx[e, q] + 2.0 * uy * circles.xy[e, q]) + uy * uy * circles.yy[e, q]
        spread += height_std * height_std
        out.ux[q], out.uy[q] = ux, uy
        for j in range(low, high):
            residual = seen.length_m[e, j] - expected[q]
            information = 1.0 / (spread + seen.length_variance_m2[e, j])
            square = residual * residual * information
            if square < gate2:
                ratio = seen.direct_ratio[e, j] if q == 0 else 1.0
                out.path[count], out.residual[count], out.information[count] = j, residual, information
                out.relative[count] = scale * ratio * np.exp(-0.5 * square) * np.sqrt(information)
                count += 1
    out.begin[last] = count
    return count
