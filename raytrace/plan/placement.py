"""Where an agent walks and anchors hang, in a plan that does not say.

The walk stays in one space of the plan (:mod:`raytrace.plan.space`). It starts at one end
and goes, time and again, along the shortest path to what is farthest from all it has passed,
until everything is near it or it is long enough; anchors are put one by one where they see
most of the walk that too few anchors saw before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from estimator.errors import InputError
from raytrace.plan.space import main_space
from raytrace.plan.trajectory import smoothed_track

__all__ = ["Walk", "place_anchors", "plan_walk"]

Array = NDArray[np.float64]

# What smoothing cuts off a corner is less than the clearance.
_SMOOTHING_M = 0.5
# Points of the lattice on which routes are sought: enough for doors, few enough for seconds.
_NODES, _MOST_NODES = 5_000, 15_000
_FINEST_M, _COARSEST_M = 0.1, 0.3
# What is nearer than this to the walk need not be visited.
_NEAR_M = 2.5
# A route may touch the rim of the free space, on which middles of doors lie.
_TOUCHED_M = 1e-6
# Off the lattice on which walls are drawn.
_ORIGIN = (0.37, 0.41)


@dataclass(frozen=True)
class Walk:
    """A track as a floor plan states it.

    Parameters
    ----------
    waypoints_m : tuple of tuple
        Way-points, metres.
    step_m : float
        Distance between epochs, metres.
    epochs : int
        Number of epochs.
    smoothing_m : float
        Window of the moving average, metres.
    """

    waypoints_m: tuple[tuple[float, float], ...]
    step_m: float
    epochs: int
    smoothing_m: float = _SMOOTHING_M


def plan_walk(
    start_m: Array,
    end_m: Array,
    thickness_m: Array,
    most_epochs: int = 236,
    step_m: float = 0.5,
    free: shapely.Geometry | None = None,
    start_at_m: tuple[float, float] | None = None,
) -> Walk:
    """A walk through a connected free space.

    Parameters
    ----------
    start_m, end_m : ndarray, shape (n, 2)
        Ends of the walls, metres.
    thickness_m : ndarray, shape (n,)
        Their thickness, metres.
    most_epochs : int
        Length of the walk in steps.
    step_m : float
        Step of a long walk, metres; a short one is divided into sixty steps.
    free : shapely.Polygon, optional
        Where to walk; by default the plan's main space (:func:`raytrace.plan.space.main_space`).
    start_at_m : tuple of float, optional
        Where to start, metres, or as near as the walk can; by default at one end of the space.

    Raises
    ------
    InputError
        If nothing is wide enough to walk in.
    """
    free = main_space(start_m, end_m, thickness_m).free if free is None else free
    longest_m = 1.1 * most_epochs * step_m
    middle = start_at_m or shapely.get_coordinates(shapely.point_on_surface(free))[:1].ravel()
    free = _part_within(free, np.array(middle)[None], longest_m)
    nodes, graph = _lattice(free)
    if len(nodes) < 3:
        raise InputError(f"walls: expected space to walk in, got {shapely.area(free):.3g} m2 off the walls")
    at = None if start_at_m is None else int(np.argmin(np.linalg.norm(nodes - start_at_m, axis=1)))
    rim = shapely.boundary(shapely.buffer(free, _TOUCHED_M))
    shapely.prepare(rim)
    legs = [_taut(nodes[leg], rim) for leg in _explore(graph, longest_m, at)]
    waypoints = np.round(np.vstack([legs[0][:1], *(leg[1:] for leg in legs)]), 3)
    length = float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())
    step = step_m if length > 60 * step_m else round(length / 60, 4)
    epochs = min(most_epochs, int(length / step))
    while True:  # smoothing cuts corners: the track is a little shorter than its polyline
        try:
            smoothed_track(waypoints, _SMOOTHING_M, step, epochs)
            break
        except InputError:
            epochs -= 1
    return Walk(tuple((float(x), float(y)) for x, y in waypoints), step, epochs)


def place_anchors(
    start_m: Array,
    end_m: Array,
    thickness_m: Array,
    track_m: Array,
    least: int = 2,
    most: int = 6,
    wanted: int = 2,
    free: shapely.Geometry | None = None,
    range_m: float = 50.0,
) -> Array:
    """Places from which a track is seen, in the space of the track.

    Parameters
    ----------
    start_m, end_m : ndarray, shape (n, 2)
        Ends of the walls, metres.
    thickness_m : ndarray, shape (n,)
        Their thickness, metres.
    track_m : ndarray, shape (epochs, 2)
        The agent's track, metres.
    least, most : int
        Fewest and most anchors; after the fewest, only such that help are added.
    wanted : int
        Anchors that each position should see.
    free : shapely.Polygon, optional
        Where they may hang; by default the plan's main space.
    range_m : float
        How far from the track's bounding box they may hang, metres: what is heard well indoors.

    Returns
    -------
    ndarray, shape (anchors, 2)

    Raises
    ------
    InputError
        If there is no room for an anchor.
    """
    free = main_space(start_m, end_m, thickness_m).free if free is None else free
    nodes, _ = _lattice(_part_within(free, track_m, range_m))
    seen_from = track_m[:: max(1, len(track_m) // 60)]
    gap = np.linalg.norm(nodes[:, None] - seen_from, axis=-1).min(axis=1) if len(nodes) else np.zeros(0)
    candidates = nodes[gap > min(1.0, 0.5 * float(gap.max(initial=0.0)))]
    candidates = candidates[:: max(1, len(candidates) // 300)]
    if len(candidates) == 0:
        raise InputError("walls: expected room for an anchor off the track, got none")
    seen = _visible(candidates, seen_from, start_m, end_m)
    count = np.zeros(len(seen_from), dtype=np.int64)
    chosen: list[int] = []
    extent = float(np.ptp(np.vstack([start_m, end_m]), axis=0).max())
    while len(chosen) < min(most, len(candidates)):
        gain = np.sum(seen & (count < wanted), axis=1).astype(np.float64)
        if len(chosen) >= least and (count >= 1).all():
            break
        if gain.max() == 0 and (len(chosen) >= least or chosen):
            break
        others = candidates[chosen] if chosen else seen_from
        spread = np.linalg.norm(candidates[:, None] - others, axis=-1).min(axis=1)
        gain += len(seen_from) * 0.3 * np.minimum(spread / extent, 0.5)
        gain[chosen] = -1.0
        best = int(np.argmax(gain))
        chosen.append(best)
        count += seen[best]
    return np.round(candidates[chosen], 3)


def _part_within(free: shapely.Geometry, points: Array, reach_m: float) -> shapely.Geometry:
    """The connected part of an area within reach of points' bounding box, the largest there.

    An area that lies within it all is returned as it is. Of a large building the rest cannot matter.
    """
    low, high = points.min(axis=0) - reach_m, points.max(axis=0) + reach_m
    left, bottom, right, top = shapely.bounds(free)
    if free.is_empty or ((low <= (left, bottom)).all() and (high >= (right, top)).all()):
        return free
    near = shapely.intersection(free, shapely.box(*low, *high))
    return max(shapely.get_parts(near), key=shapely.area, default=free)


def _lattice(free: shapely.Geometry) -> tuple[Array, csr_array]:
    """Points of a lattice within an area, and the lengths of the links between neighbours."""
    if free.is_empty:
        return np.zeros((0, 2)), csr_array((0, 0))
    pitch = float(np.clip(np.sqrt(free.area / _NODES), _FINEST_M, _COARSEST_M))
    pitch = max(pitch, float(np.sqrt(free.area / _MOST_NODES)))
    left, bottom, right, top = free.bounds
    across = np.arange(left + _ORIGIN[0] * pitch, right, pitch)
    upward = np.arange(bottom + _ORIGIN[1] * pitch, top, pitch)
    points = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1)
    shapely.prepare(free)
    inside = shapely.contains_xy(free, points[..., 0], points[..., 1])
    number = np.where(inside, np.cumsum(inside.ravel()).reshape(inside.shape) - 1, -1)
    links = []
    columns, rows = number.shape
    for right_by, up_by in ((1, 0), (0, 1), (1, 1), (1, -1)):
        low, high = max(0, -up_by), rows - max(0, up_by)
        one = number[: columns - right_by, low:high]
        other = number[right_by:, low + up_by : high + up_by]
        both = (one >= 0) & (other >= 0)
        links.append(np.stack([one[both], other[both]], axis=1))
    nodes = points[inside]
    pairs = np.concatenate(links)
    clear = shapely.covers(free, shapely.linestrings(nodes[pairs])) if len(pairs) else np.zeros(0, bool)
    pairs = pairs[clear]
    graph = _graph(nodes, pairs)
    if connected_components(graph, directed=False)[0] > 1:  # a door fell between two points
        nodes, pairs = _through_doors(free, nodes, pairs)
        graph = _graph(nodes, pairs)
    return nodes, graph


def _graph(nodes: Array, pairs: NDArray[np.int64]) -> csr_array:
    length = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    graph = csr_array((length, (pairs[:, 0], pairs[:, 1])), shape=(len(nodes), len(nodes)))
    return csr_array(graph + graph.T)


def _through_doors(
    free: shapely.Geometry, nodes: Array, pairs: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """More nodes and links, those of a triangulation, which joins whatever the area joins.

    Each triangle links the midpoints of its sides with one another and with the nodes inside it.
    """
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(free))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)
    middles = 0.5 * (corners[:, :3] + corners[:, 1:])
    places, inverse = np.unique(np.round(middles.reshape(-1, 2), 6), axis=0, return_inverse=True)
    sides = len(nodes) + inverse.reshape(-1, 3)
    node, triangle = shapely.STRtree(triangles).query(shapely.points(nodes), predicate="intersects")
    links = [
        pairs,
        *(sides[:, [one, other]] for one, other in ((0, 1), (1, 2), (2, 0))),
        *(np.column_stack([node, sides[triangle, side]]) for side in range(3)),
    ]
    found = np.unique(np.sort(np.concatenate(links), axis=1), axis=0)
    return np.vstack([nodes, places]), found[found[:, 0] != found[:, 1]]


def _explore(graph: csr_array, most_m: float, at: int | None = None) -> list[list[int]]:
    """Routes from stop to stop, each to the node that is farthest from all routes before.

    The first begins at node ``at``, by default at one end.
    """
    if at is None:
        from_any = dijkstra(graph, indices=[0])[0]
        at = int(np.argmax(np.where(np.isfinite(from_any), from_any, -1.0)))
    passed, length = [at], 0.0
    legs: list[list[int]] = []
    while length < most_m:
        gap = dijkstra(graph, indices=passed, min_only=True)
        goal = int(np.argmax(np.where(np.isfinite(gap), gap, -1.0)))
        if legs and gap[goal] < _NEAR_M:
            break
        (reach,), (before,) = dijkstra(graph, indices=[at], return_predecessors=True)
        leg = [goal]
        while leg[-1] != at:
            leg.append(int(before[leg[-1]]))
        legs.append(leg[::-1])
        passed += leg
        length += float(reach[goal])
        at = goal
    return legs


def _taut(points: Array, rim: shapely.Geometry) -> Array:
    """A route with every point left out that a straight line makes needless: one that crosses no rim."""
    kept, at = [0], 0
    while at < len(points) - 1:
        ahead = np.arange(at + 1, len(points))
        straight = shapely.linestrings(
            np.stack([np.broadcast_to(points[at], (len(ahead), 2)), points[ahead]], 1)
        )
        clear = np.flatnonzero(~shapely.intersects(rim, straight))
        at = int(ahead[clear[-1]]) if len(clear) else at + 1
        kept.append(at)
    return points[kept]


def _visible(sources: Array, targets: Array, start_m: Array, end_m: Array) -> NDArray[np.bool_]:
    """Which targets (m, 2) no wall hides from sources (n, 2), shape (n, m)."""
    ends = np.stack(np.broadcast_arrays(sources[:, None], targets[None]), axis=2)
    rays = shapely.linestrings(ends.reshape(-1, 2, 2))
    walls = shapely.multilinestrings(shapely.linestrings(np.stack([start_m, end_m], axis=1)))
    shapely.prepare(walls)
    return np.asarray(~shapely.intersects(walls, rays)).reshape(len(sources), len(targets))
