"""Paths over lines without ends: where each bounces, and which other lines its legs cross.

The walls of a map are lines (VRPs). Mirror images unfold every line of sight, single and double bounce from
every anchor to every position; whether such a path exists is then a matter of where the walls end: each
bounce must lie on its wall, and no leg may cross one. :class:`Unfolded` tells both as coordinates along the
lines, so that any choice of ends can be judged without geometry.

A line's coordinate counts from the foot of RP's perpendicular, along the direction to the VRP turned by +90
degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.geometry import mirror, wall_normal

__all__ = ["MOST_CROSSINGS", "Unfolded", "crossing_points", "line_frames", "unfold"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
MOST_CROSSINGS = 40_000_000
"""Entries of the table of crossings that are formed at most: 320 MB."""
_TIP = 1e-6  # share of a leg, at either end, that crosses nothing: it begins on a wall


@dataclass(frozen=True, eq=False)
class Unfolded:
    """Candidate paths of T positions, K anchors and F features.

    Parameters
    ----------
    walls : ndarray of int64, shape (F, 2)
        Walls of each feature, from the anchor to the agent; -1 beyond the last.
    possible : ndarray of bool, shape (T, K, F)
        Whether lines without ends would give the path.
    length_m : ndarray, shape (T, K, F)
        Horizontal length.
    bounce_m : ndarray, shape (T, K, F, 2)
        Coordinate of each bounce along its wall; NaN where there is none.
    crossing_m : ndarray, shape (T, K, F, 3, L)
        Coordinate at which each leg, from the anchor on, crosses each line; NaN where it does not.
    vertex_m : ndarray, shape (T, K, F, 4, 2)
        Anchor, bounces and agent; the agent is repeated after the last.
    """

    walls: Index
    possible: Mask
    length_m: Array
    bounce_m: Array
    crossing_m: Array
    vertex_m: Array


def line_frames(vrps_m: ArrayLike) -> tuple[Array, Array, Array]:
    """Feet (L, 2), tangents (L, 2) and normals (L, 2) of the lines that VRPs (L, 2) stand for."""
    vrps = np.asarray(vrps_m, dtype=np.float64).reshape(-1, 2)
    normal = wall_normal(vrps) if len(vrps) else vrps
    return 0.5 * vrps, np.stack([-normal[:, 1], normal[:, 0]], axis=-1), normal


def crossing_points(vrps_m: ArrayLike) -> Array:
    """Where lines meet: coordinate along line i of its crossing with line j, (L, L); NaN of parallels."""
    foot, tangent, normal = line_frames(vrps_m)
    slope = tangent @ normal.T  # of line i across line j
    gap = np.sum(foot * normal, axis=1)[None, :] - foot @ normal.T
    return np.where(np.abs(slope) > 1e-6, gap / np.where(slope == 0.0, 1.0, slope), np.nan)


def unfold(vrps_m: ArrayLike, anchors_m: ArrayLike, track_m: ArrayLike, order: int = 2) -> Unfolded:
    """Unfold all paths of up to ``order`` bounces, two at most.

    Parameters
    ----------
    vrps_m : array_like, shape (L, 2)
        Walls; RP is the origin.
    anchors_m : array_like, shape (K, 2)
        Anchors.
    track_m : array_like, shape (T, 2)
        Positions of the agent.
    order : int
        Most bounces.

    Raises
    ------
    InputError
        If the table would not fit into memory: fewer positions, walls or bounces are needed.
    """
    vrps = np.asarray(vrps_m, dtype=np.float64).reshape(-1, 2)
    anchors = np.asarray(anchors_m, dtype=np.float64).reshape(-1, 2)
    track = np.asarray(track_m, dtype=np.float64).reshape(-1, 2)
    sequences = [sequence for n in range(order + 1) for sequence in permutations(range(len(vrps)), n)]
    shape = len(track), len(anchors), len(sequences)
    if 3 * int(np.prod(shape)) * max(len(vrps), 1) > MOST_CROSSINGS:
        raise InputError(
            f"twin: expected at most {MOST_CROSSINGS} crossings of paths with lines, got "
            f"{3 * int(np.prod(shape)) * len(vrps)}: {len(track)} positions, {len(anchors)} anchors, "
            f"{len(vrps)} walls and {order} bounces"
        )
    walls = np.array([(*s, *(-1,) * (2 - len(s))) for s in sequences], dtype=np.int64).reshape(-1, 2)
    vertex = np.empty((*shape, 4, 2))
    possible = np.ones(shape, dtype=bool)
    bounce = np.full((*shape, 2), np.nan)
    foot, tangent, normal = line_frames(vrps)
    for f, sequence in enumerate(sequences):
        images = [anchors]
        for wall in sequence:
            images.append(mirror(images[-1], vrps[wall]))
        point = np.broadcast_to(track[:, None], (*shape[:2], 2))
        vertex[:, :, f] = point[:, :, None]
        for number in reversed(range(len(sequence))):
            wall, target = sequence[number], images[number + 1][None]
            before = (point - foot[wall]) @ normal[wall]
            after = (target - foot[wall]) @ normal[wall]
            share = before / np.where(before == after, 1.0, before - after)
            possible[:, :, f] &= before * after < 0.0
            point = point + share[..., None] * (target - point)
            bounce[:, :, f, number] = (point - foot[wall]) @ tangent[wall]
            vertex[:, :, f, number + 1] = point
        vertex[:, :, f, 0] = anchors[None]
    possible &= np.isfinite(vertex).all(axis=(-1, -2))
    length = np.linalg.norm(np.diff(vertex, axis=3), axis=-1).sum(axis=-1)
    crossing = _crossings(vertex, walls, foot, tangent, normal)
    return Unfolded(walls, possible, length, bounce, crossing, vertex)


def _crossings(vertex: Array, walls: Index, foot: Array, tangent: Array, normal: Array) -> Array:
    """Where legs cross lines (T, K, F, 3, L); the lines that they begin or end on are not crossed."""
    side = vertex @ normal.T - np.sum(foot * normal, axis=1)  # (T, K, F, 4, L)
    before, after = side[..., :-1, :], side[..., 1:, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = before / (before - after)
    share = np.where(np.isfinite(share), share, -1.0)
    along = vertex @ tangent.T - np.sum(foot * tangent, axis=1)
    place = along[..., :-1, :] + share * (along[..., 1:, :] - along[..., :-1, :])
    crossed = (share > _TIP) & (share < 1.0 - _TIP)
    lines = np.arange(len(foot))
    for leg in range(3):
        begins = walls[:, leg - 1] if leg else np.full(len(walls), -1)
        ends = walls[:, leg] if leg < 2 else np.full(len(walls), -1)
        own = (lines == begins[:, None]) | (lines == ends[:, None])
        crossed[:, :, :, leg] &= ~own
    return np.where(crossed, place, np.nan)
