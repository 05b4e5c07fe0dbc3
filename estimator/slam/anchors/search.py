"""Places of an anchor from path lengths with unknown labels (Section IV-B1).

Every path length puts the anchor on a circle round a known centre; which one is unknown. Pairs of circles
give seeds, each is scored by all the paths, refined, and weighed by its evidence. The cost is that of
:class:`estimator.slam.anchors.cells.SearchLimits`, whatever was heard.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.cells import Cells, SearchLimits
from estimator.slam.anchors.circles import Circles, image_circles, met_wall_pairs
from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.evidence import weigh
from estimator.slam.anchors.likelihood import Model, Place, model_of, room_for
from estimator.slam.anchors.observations import NoiseModel, Observations
from estimator.slam.anchors.refinement import refine
from estimator.slam.anchors.seeds import apart, choose_seeds

__all__ = ["Candidates", "Scene", "evidence_at", "find_places", "scene_of"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Scene:
    """What an anchor is searched in: circles, paths and walls.

    Parameters
    ----------
    circles : Circles
        Centres of all epochs.
    seen : Observations
        The anchor's paths.
    vrp_m : ndarray, shape (L, 2)
        Walls: an anchor is heard over one only from RP's side.
    model : Model
        Numbers.
    """

    circles: Circles
    seen: Observations
    vrp_m: Array
    model: Model


@dataclass(frozen=True, eq=False)
class Candidates:
    """Where the anchor may be, best first.

    Parameters
    ----------
    mean_m : ndarray, shape (S, 2)
        Positions.
    covariance_m2 : ndarray, shape (S, 2, 2)
        Covariances from the matched paths alone.
    log_evidence : ndarray, shape (S,)
        Log evidence over "all is clutter".
    matches : ndarray of int64, shape (S,)
        Number of features of up to one bounce that most epochs show.
    fresh : ndarray of int64, shape (S,)
        How many of these features the last epoch shows for sure.
    bias_m : ndarray, shape (S,)
        Clock bias that was taken off the path lengths.
    height2_m2, height2_std_m2 : ndarray, shape (S,)
        Squared height difference that was assumed, and its standard deviation.
    """

    mean_m: Array
    covariance_m2: Array
    log_evidence: Array
    matches: Index
    fresh: Index
    bias_m: Array
    height2_m2: Array
    height2_std_m2: Array

    def __len__(self) -> int:
        return len(self.mean_m)

    def take(self, index: Index) -> Candidates:
        """Those at ``index``."""
        return Candidates(*(column[index] for column in vars(self).values()))


def scene_of(
    seen: Observations,
    vrp_m: Array,
    vrp_covariance_m2: Array,
    noise: NoiseModel,
    config: AnchorSearchConfig,
    extra_variance_m2: float = 0.0,
) -> Scene:
    """The circles of some observations.

    Parameters
    ----------
    seen : Observations
        Paths.
    vrp_m, vrp_covariance_m2 : ndarray, shapes (L, 2), (L, 2, 2)
        Walls that count as found.
    noise, config
        Models.
    extra_variance_m2 : float
        To be added to the variance of every length: what its clock bias may be off.
    """
    vrp, spread = np.ascontiguousarray(vrp_m), np.ascontiguousarray(vrp_covariance_m2)
    pairs = met_wall_pairs(seen.position_m, vrp, config.wall_pair_margin_m, config.max_wall_pairs)
    variance = seen.length_variance_m2 + extra_variance_m2
    widest, gate = variance.max(axis=1), float(config.search_gate_sigma)
    circles = image_circles(seen.position_m, seen.covariance_m2, widest, vrp, spread, pairs, gate)
    seen = seen._replace(length_variance_m2=variance)
    return Scene(circles, seen, vrp, model_of(circles, noise, config))


def find_places(
    scene: Scene, cells: Cells, limits: SearchLimits, prune_nats: float, config: AnchorSearchConfig
) -> Candidates:
    """The places from which the paths of an anchor make sense, possibly none.

    Parameters
    ----------
    scene : Scene
        Circles and paths; the last epoch's circles are intersected, all epochs weigh where they meet.
    cells : Cells
        Clock biases and heights that are tried.
    limits : SearchLimits
        What the search may cost.
    prune_nats : float
        Places this far below the best are dropped.
    config : AnchorSearchConfig
        Models.
    """
    x, y, cell = choose_seeds(
        scene.circles,
        scene.seen,
        cells,
        scene.vrp_m,
        scene.model,
        limits,
        config.seed_radius_m,
        config.touch_m2,
    )
    columns = [x, y, cells.bias_m[cell], cells.height2_m2[cell], cells.height2_std_m2[cell]]
    start = np.stack(columns, axis=1)
    points, spread, total, matches, fresh = _settled(
        start, scene.circles, scene.seen, scene.vrp_m, scene.model
    )
    total = total + cells.log_prior[cell]
    inside = np.all(np.isfinite(points), axis=1) & np.isfinite(total)
    inside &= np.hypot(points[:, 0], points[:, 1]) < 2.0 * scene.model.region_m
    order = np.argsort(np.where(inside, -total, np.inf), kind="stable")[: np.count_nonzero(inside)]
    spot, most = np.column_stack([points, start[:, 2]]), config.start_attempts
    kept = apart(spot, order, config.place_radius_m, np.zeros(len(spot), dtype=np.int64), most, most)
    kept = kept[total[kept] > total[kept].max(initial=-np.inf) - prune_nats]
    return Candidates(points[kept], spread[kept], total[kept], matches[kept], fresh[kept], *start[kept, 2:].T)


def evidence_at(
    scene: Scene, points_m: Array, bias_m: float, height2_m2: float = 0.0, height2_std_m2: float = 0.0
) -> Array:
    """Log evidence (S,) of the anchor near ``points_m`` (S, 2), on the scale of :func:`find_places`."""
    start = np.empty((len(points_m), 5))
    start[:, :2], start[:, 2:] = points_m, (bias_m, height2_m2, height2_std_m2)
    return _settled(start, scene.circles, scene.seen, scene.vrp_m, scene.model)[2]


@compiled
def _settled(
    start: Array, circles: Circles, seen: Observations, vrp: Array, model: Model
) -> tuple[Array, Array, Array, Index, Index]:
    """Refined places (S, 2), their covariances, log evidence and matches, from ``start`` (S, 5)."""
    count = len(start)
    points, spread, total = np.empty((count, 2)), np.empty((count, 2, 2)), np.empty(count)
    matches, fresh = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    out = room_for(circles.x.shape[1], model.max_gated)
    for s in range(count):
        first = Place(start[s, 0], start[s, 1], start[s, 2], start[s, 3], start[s, 4])
        x, y, xx, xy, yy = refine(first, circles, seen, vrp, model, out)
        points[s, 0], points[s, 1] = x, y
        determinant = xx * yy - xy * xy
        spread[s, 0, 0], spread[s, 1, 1] = yy / determinant, xx / determinant
        spread[s, 0, 1] = spread[s, 1, 0] = -xy / determinant
        place = Place(x, y, first.bias, first.height2, first.height2_std)
        total[s], matches[s], fresh[s] = weigh(place, (xx, xy, yy), circles, seen, vrp, model, out)
    return points, spread, total, matches, fresh
