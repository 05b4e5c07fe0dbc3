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

__all__ = ["Model", "Place", "expected_length", "gate_circle", "is_behind", "model_of", "walls_between"]

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
    visibility : ndarray, shape (3,)
        Prior probability that a path of 0, 1, 2 bounces is there.
    sure_probability, behind_wall_log_prior : float
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
    sure_probability: float
    behind_wall_log_prior: float
    region_m: float
    max_gated: int


def model_of(noise: NoiseModel, config: AnchorSearchConfig) -> Model:
    """The numbers of a noise model and a configuration."""
    prior = config.search_visibility_los, config.search_visibility_wall, config.search_visibility_pair
    return Model(
        float(noise.detection_probability),
        float(noise.clutter_density),
        float(config.search_gate_sigma),
        np.array(prior),
        float(config.sure_probability),
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
    height2 : float
        Squared height difference, square metres.
    """

    x: float
    y: float
    bias: float
    height2: float


@compiled
def is_behind(x: float, y: float, vx: float, vy: float) -> bool:
    """Whether a place is not on RP's side of the wall of a VRP."""
    size = np.sqrt(vx * vx + vy * vy)
    return bool((x * vx + y * vy) / size - 0.5 * size >= 0.0)


@compiled
def walls_between(x: float, y: float, vrp: Array) -> int:
    """Number of the walls (L, 2) behind which a place stands."""
    behind = 0
    for w in range(len(vrp)):
        if is_behind(x, y, vrp[w, 0], vrp[w, 1]):
            behind += 1
    return behind


@compiled
def expected_length(place: Place, circles: Circles, e: int, q: int) -> tuple[float, float, float, float]:
    """Length of the path of circle ``q`` of epoch ``e``, its derivative by the place, and its variance.

    The variance is that of the circle's centre in this direction.
    """
    dx, dy = place.x - circles.x[e, q], place.y - circles.y[e, q]
    slant = max(np.sqrt(dx * dx + dy * dy + place.height2), 1e-6)
    ux, uy = dx / slant, dy / slant
    variance = ux * (ux * circles.xx[e, q] + 2.0 * uy * circles.xy[e, q]) + uy * uy * circles.yy[e, q]
    return place.bias + slant, ux, uy, variance


@compiled
def gate_circle(
    place: Place,
    circles: Circles,
    seen: Observations,
    widest: Array,
    e: int,
    q: int,
    model: Model,
    path: Index,
    relative: Array,
) -> int:
    """The paths that circle ``q`` of epoch ``e`` may explain: how many, their numbers and likelihoods.

    ``widest`` (E,) is the largest variance of an epoch's paths. Numbers and likelihoods, relative to
    clutter's, are put at the beginning of ``path`` and ``relative`` (``max_gated``,).
    """
    expected, _, _, variance = expected_length(place, circles, e, q)
    reach = model.gate_sigma * np.sqrt(variance + widest[e])
    low, high = 0, seen.paths[e]
    while low < high:  # the first path that is not too short
        middle = (low + high) // 2
        if seen.length_m[e, middle] < expected - reach:
            low = middle + 1
        else:
            high = middle
    end = low
    while end < seen.paths[e] and seen.length_m[e, end] <= expected + reach:
        end += 1
        if end - low > model.max_gated:  # keep those nearest to the expected length
            if expected - seen.length_m[e, low] >= seen.length_m[e, end - 1] - expected:
                low += 1
            else:
                end -= 1
                break
    count = 0
    for j in range(low, end):
        residual = seen.length_m[e, j] - expected
        total = variance + seen.length_variance_m2[e, j]
        square = residual * residual / total
        if square < model.gate_sigma * model.gate_sigma:
            density = np.exp(-0.5 * square) / np.sqrt(2.0 * np.pi * total)
            ratio = seen.direct_ratio[e, j] if q == 0 else 1.0
            path[count] = j
            relative[count] = density / model.clutter_density * ratio
            count += 1
    return count
