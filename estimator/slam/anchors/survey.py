"""An anchor surveyed from a known track: delayed evidence in place of early decisions.

Where echoes or odometry tell the track, an anchor can wait. All of its paths heard along the track,
associated or not, are weighed together: a grid of places and heights, then annealed expectation-maximisation
on place and squared height from the best of them. The evidence is path-wise: each path is clutter or comes
from one of the circles, so that a feature may be hidden for a while.

Time is that of the grid, ``survey_points`` times ``height_cells`` places times ``survey_grid_epochs`` epochs
times the circles of up to one bounce and the paths near them, once more at each finer spacing; and of
``survey_seeds`` refinements over all epochs and circles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.observations import Observations
from estimator.slam.anchors.search import Scene
from estimator.slam.models.extents import bounce_along_wall
from estimator.slam.models.features import side_of_wall

__all__ = ["Survey", "survey_anchor"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_LEAST_M2 = 1e-6  # numerical floor of squared lengths


@dataclass(frozen=True, eq=False)
class Survey:
    """Places that an anchor may stand at, the likeliest first.

    Parameters
    ----------
    place : ndarray, shape (S, 3)
        x, y, metres, and the squared height difference, square metres.
    covariance : ndarray, shape (S, 3, 3)
        Covariances from the paths, given the track.
    lever : ndarray, shape (S, E, 3, 2)
        How far the place moves with the agent's position at each epoch.
    log_evidence : ndarray, shape (S,)
        Over "all is clutter".
    present : int
        Which of them was reached from the place given, -1 if none was.
    """

    place: Array
    covariance: Array
    lever: Array
    log_evidence: Array
    present: int

    def margin(self, which: int, apart_m: float) -> float:
        """By how many nats place ``which`` is likelier than all others that are ``apart_m`` or more away."""
        away = np.hypot(*(self.place[:, :2] - self.place[which, :2]).T) > apart_m
        return float(self.log_evidence[which] - np.max(self.log_evidence[away], initial=0.0))


@compiled
def _weigh(
    x: float,
    y: float,
    w: float,
    bias: float,
    circles: Circles,
    seen: Observations,
    side: NDArray[np.bool_],
    share: Array,
    clutter: float,
    extra: float,
    information: Array,
    slope: Array,
    pull: Array,
) -> float:
    """Log evidence of a place; information (3, 3) and slope (3,) of the paths' residuals, by responsibility.

    How the slope changes with the agent's position at each epoch is ``pull`` (E, 3, 2).

    Variances are larger by ``extra`` square metres.
    """
    epochs, features = circles.x.shape
    total = 0.0
    information[:, :] = 0.0
    slope[:] = 0.0
    pull[:, :, :] = 0.0
    expected, variance = np.empty(features), np.empty(features)
    own = np.empty(features)
    free = 1.0 - share.sum()
    for e in range(epochs):
        for q in range(features):
            expected[q] = -1.0
            if 0 < q <= circles.walls and not side[e, q - 1]:
                continue
            dx, dy = x - circles.x[e, q], y - circles.y[e, q]
            square = max(dx * dx + dy * dy + w, _LEAST_M2)
            expected[q] = np.sqrt(square)
            spread = dx * (dx * circles.xx[e, q] + 2.0 * dy * circles.xy[e, q]) + dy * dy * circles.yy[e, q]
            variance[q] = spread / square + extra
        for m in range(seen.paths[e]):
            mass = free
            for q in range(features):
                own[q] = 0.0
                if expected[q] < 0.0:
                    continue
                residual = seen.length_m[e, m] - bias - expected[q]
                v = variance[q] + seen.length_variance_m2[e, m]
                if residual * residual > 25.0 * v:
                    continue
                ratio = seen.direct_ratio[e, m] if q == 0 else 1.0
                own[q] = share[q] * ratio * np.exp(-0.5 * residual * residual / v) / np.sqrt(2.0 * np.pi * v)
                own[q] /= clutter
                mass += own[q]
            total += np.log(mass)
            for q in range(features):
                if own[q] == 0.0:
                    continue
                residual = seen.length_m[e, m] - bias - expected[q]
                weight = own[q] / mass / (variance[q] + seen.length_variance_m2[e, m])
                gx = (x - circles.x[e, q]) / expected[q]
                gy = (y - circles.y[e, q]) / expected[q]
                gw = 0.5 / expected[q]
                slope[0] += weight * gx * residual
                slope[1] += weight * gy * residual
                slope[2] += weight * gw * residual
                information[0, 0] += weight * gx * gx
                information[0, 1] += weight * gx * gy
                information[0, 2] += weight * gx * gw
                information[1, 1] += weight * gy * gy
                information[1, 2] += weight * gy * gw
                information[2, 2] += weight * gw * gw
                for axis in range(2):
                    by = gx * circles.by_agent[q, 0, axis] + gy * circles.by_agent[q, 1, axis]
                    pull[e, 0, axis] += weight * gx * by
                    pull[e, 1, axis] += weight * gy * by
                    pull[e, 2, axis] += weight * gw * by
    information[1, 0], information[2, 0], information[2, 1] = (
        information[0, 1],
        information[0, 2],
        information[1, 2],
    )
    return total


@compiled
def _grid(
    points: Array,
    height2: Array,
    bias: float,
    circles: Circles,
    seen: Observations,
    rows: Index,
    width: float,
) -> tuple[Array, Index]:
    """Of each point (P, 2) the best height and its score: paths within ``width`` of a circle, softly."""
    score, cell = np.full(len(points), -1.0), np.zeros(len(points), dtype=np.int64)
    square = np.empty(1 + circles.walls)
    for p in range(len(points)):
        for h in range(height2.size):
            total = 0.0
            for row in range(rows.size):
                e = rows[row]
                for q in range(1 + circles.walls):
                    dx, dy = points[p, 0] - circles.x[e, q], points[p, 1] - circles.y[e, q]
                    square[q] = np.sqrt(dx * dx + dy * dy + height2[h]) + bias
                for m in range(seen.paths[e]):
                    best = 0.0
                    for q in range(1 + circles.walls):
                        gap = (seen.length_m[e, m] - square[q]) / width
                        if gap * gap < 1.0:
                            credit = 1.0 - gap * gap
                            if q == 0:
                                credit *= min(2.0, 0.5 + seen.direct_ratio[e, m])
                            best = max(best, credit)
                    total += best
                    if seen.length_m[e, m] < square[0] - 2.0 * width:
                        total -= 1.0  # no path is shorter than the line of sight
            if total > score[p]:
                score[p], cell[p] = total, h
    return score, cell


@compiled
def _may_bounce(
    ax: float, ay: float, px: float, py: float, vx: float, vy: float, first: float, last: float
) -> bool:
    """Whether a wall may reflect from ``a`` to ``p``: both on one side, the bounce on its stretch."""
    if not side_of_wall(ax, ay, vx, vy) * side_of_wall(px, py, vx, vy) > 0.0:
        return False
    return first <= bounce_along_wall(px, py, ax, ay, vx, vy) <= last


@compiled
def _refine(
    start: Array,
    found: int,
    bias: float,
    circles: Circles,
    seen: Observations,
    vrp: Array,
    stretch: Array,
    side: NDArray[np.bool_],
    share: Array,
    halvings: int,
    clutter: float,
    widths: Array,
    height_scale_m: float,
    area_m2: float,
) -> tuple[Array, Array, Array, Array]:
    """Places (S, 3) annealed from ``start`` through ``widths``; covariances, levers and log evidence.

    Those from ``found`` on are known already: the last two widths are theirs.
    """
    count = len(start)
    place, spread, total = start.copy(), np.empty((count, 3, 3)), np.empty(count)
    information, slope = np.empty((3, 3)), np.empty(3)
    lever = np.empty((count, side.shape[0], 3, 2))
    walls = vrp.shape[0]
    for s in range(count):
        for width in widths[0 if s < found else -2 :]:
            for _ in range(3):
                for e in range(side.shape[0]):
                    for i in range(walls):
                        side[e, i] = _may_bounce(
                            place[s, 0], place[s, 1], circles.x[e, 0], circles.y[e, 0],
                            vrp[i, 0], vrp[i, 1], stretch[i, 0], stretch[i, 1],
                        )  # fmt: skip
                total[s] = _weigh(
                    place[s, 0], place[s, 1], place[s, 2], bias, circles, seen, side, share, clutter,
                    width * width, information, slope, lever[s],
                )  # fmt: skip
                information[0, 0] += 1e-4
                information[1, 1] += 1e-4
                information[2, 2] += 1e-4
                move = np.linalg.solve(information, slope)
                size = np.sqrt(move[0] * move[0] + move[1] * move[1])
                scale = min(1.0, 2.0 / max(size, 1e-9))
                place[s] += scale * move
                place[s, 2] = max(place[s, 2], 0.0)
        spread[s] = np.linalg.inv(information)
        total[s] = -np.inf
        for halving in range(halvings, -1, -1):
            at = _weigh(
                place[s, 0], place[s, 1], place[s, 2], bias, circles, seen, side, share * 0.5**halving,
                clutter, 0.0, information, slope, lever[s],
            )  # fmt: skip
            total[s] = np.logaddexp(total[s], at - np.log(1.0 + halvings))
        for e in range(side.shape[0]):
            lever[s, e] = spread[s] @ lever[s, e]
        height = max(np.sqrt(place[s, 2]), 0.1)
        prior = np.exp(-height / height_scale_m) / height_scale_m / (2.0 * height)  # of the squared height
        total[s] += (
            np.log(prior / area_m2) + 1.5 * np.log(2.0 * np.pi) + 0.5 * np.log(np.linalg.det(spread[s]))
        )
    return place, spread, lever, total


def _seeds(
    scene: Scene,
    centre: Array,
    reach: float,
    rows: Index,
    bias_m: float,
    height2: Array,
    config: AnchorSearchConfig,
) -> tuple[Array, float]:
    """The best places (S, 3) of a grid that is made finer round its best points, and its last spacing."""
    spacing = max(config.survey_spacing_m, reach * float(np.sqrt(np.pi / config.survey_points)))
    line = np.arange(-reach - spacing, reach + 2.0 * spacing, spacing)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) <= reach + spacing] + centre
    height2 = height2[:: config.survey_height_stride]
    score, cell = _grid(grid, height2, bias_m, scene.circles, scene.seen, rows, spacing)
    third = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
    while spacing > config.survey_spacing_m:
        spacing /= 3.0
        best = np.argsort(-score, kind="stable")[: config.survey_points // len(third)]
        grid = (grid[best, None] + spacing * third).reshape(-1, 2)
        score, cell = _grid(grid, height2, bias_m, scene.circles, scene.seen, rows, spacing)
    kept: list[int] = []
    apart = 2.0 * max(spacing, 0.5 * config.survey_spacing_m)
    for p in np.argsort(-score, kind="stable").tolist():
        if all(np.hypot(*(grid[p] - grid[other])) > apart for other in kept):
            kept.append(p)
            if len(kept) == config.survey_seeds:
                break
    return np.column_stack([grid[kept], height2[cell[kept]]]), spacing


def survey_anchor(
    scene: Scene,
    stretch_m: Array,
    bias_m: float,
    height2: Array,
    present: Array | None,
    config: AnchorSearchConfig,
) -> Survey:
    """Where an anchor stands, from all that was heard of it along the track.

    Parameters
    ----------
    scene : Scene
        Circles and paths of the surveyed epochs; at least one path.
    stretch_m : ndarray, shape (L, 2)
        First and last place along each wall that may reflect: signed distances from the foot of RP, metres.
    bias_m : float
        The anchor's clock bias, metres.
    height2 : ndarray, shape (H,)
        Squared heights of the grid, square metres.
    present : ndarray, shape (3,), optional
        Where the anchor is thought to stand, squared height last.
    config : AnchorSearchConfig
        Limits.
    """
    circles, seen, model = scene.circles, scene.seen, scene.model
    heard = np.flatnonzero(seen.paths > 0)
    first = seen.length_m[heard, 0] - bias_m
    nearest = np.argsort(first, kind="stable")[int(config.survey_near_share * (heard.size - 1))]
    reach = max(float(first[nearest]), config.survey_spacing_m)
    rows = heard[np.unique(np.linspace(0, heard.size - 1, config.survey_grid_epochs).astype(np.int64))]
    seeds, spacing = _seeds(scene, seen.position_m[heard[nearest]], reach, rows, bias_m, height2, config)
    if present is not None:
        seeds = np.concatenate([seeds, present[None]])
    start = seeds if present is None else np.concatenate([seeds, present[None]])
    pairs = circles.x.shape[1] - 1 - circles.walls
    share = np.concatenate(
        [
            [config.survey_share_los],
            np.full(circles.walls, config.survey_share_wall / max(circles.walls, 1)),
            np.full(pairs, config.survey_share_pair / max(pairs, 1)),
        ]
    )
    side = np.ones((len(seen.paths), len(scene.vrp_m)), dtype=np.bool_)
    widths = np.array([max(0.5 * spacing, 0.2), 0.2, 0.05, 0.0])
    place, spread, lever, total = _refine(
        start,
        len(seeds),
        bias_m,
        circles,
        seen,
        scene.vrp_m,
        stretch_m,
        side,
        share,
        config.survey_halvings,
        float(model.clutter_density),
        widths,
        config.height_scale_m,
        float(np.pi * reach**2),
    )
    good = np.isfinite(total) & np.all(np.isfinite(place), axis=1)
    order = np.argsort(np.where(good, -total, np.inf), kind="stable")[: int(good.sum())]
    last = len(start) - 1
    reached = np.flatnonzero(order == last) if present is not None else np.empty(0, dtype=np.int64)
    return Survey(
        place[order], spread[order], lever[order], total[order], int(reached[0]) if reached.size else -1
    )
