"""Sequences of surfaces off which light from an anchor can reach anybody, one order after the other.

A surface follows another if some of it lies in the beam that this one reflects: seen from above, with walls
hiding one another (:mod:`raytrace.propagation.beams`), and in space, where beams are pyramids.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from raytrace.propagation.beams import lit_walls
from raytrace.propagation.paths import NO_SURFACE
from raytrace.propagation.reflectors import TIP, Surfaces, mirrored

__all__ = ["Sequences", "chosen_sequences", "lit_sequences"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# An image nearer to a surface's plane, metres, lies in it, and no ray reaches the surface from there.
_IN_PLANE_M = 1e-12


@dataclass(frozen=True, eq=False)
class Sequences:
    """Sequences of as many bounces, from the anchor on.

    Parameters
    ----------
    surfaces : ndarray of int64, shape (q, order)
        The surface of each bounce.
    images : ndarray, shape (q, order + 1, 3)
        The anchor, and its image after every bounce, metres.
    wall : ndarray of int64, shape (q,)
        The last wall among the surfaces, -1 if there is none.
    spans_m : ndarray, shape (q, 2)
        The part of it that was lit, along its first side, metres.
    """

    surfaces: Indices
    images: Array
    wall: Indices
    spans_m: Array

    def __len__(self) -> int:
        return len(self.surfaces)


def lit_sequences(
    surfaces: Surfaces, anchor: Array, depth: int, top_m: float, blind: bool = False
) -> Iterator[Sequences]:
    """Sequences that light from an anchor (3,) can take, of no bounce, of one, up to ``depth``.

    Parameters
    ----------
    top_m : float
        No path is higher, metres; walls up to there hide what is behind them.
    blind : bool
        Let any surface follow any other: for paths that miss their surfaces, which have no beam.
    """
    found = _grown(surfaces, _start(anchor), np.zeros(1, np.int64), None)
    yield found
    for _ in range(depth):
        row, wall, spans = _any_other(surfaces, found) if blind else _followers(surfaces, found, top_m)
        found = _grown(surfaces, found, row, (wall, spans))
        yield found


def chosen_sequences(surfaces: Surfaces, anchor: Array, walls: NDArray[np.int16], order: int) -> Sequences:
    """The different sequences of ``order`` surfaces in ``walls`` (n, bounces), as ``PathList.walls``."""
    there = (walls >= 0) & (walls < len(surfaces))
    mine = there[:, :order].all(axis=1) & (walls[:, order:] == NO_SURFACE).all(axis=1)
    chosen = np.unique(walls[mine, :order].astype(np.int64), axis=0)
    found = _grown(surfaces, _start(anchor), np.zeros(len(chosen), np.int64), None)
    for wall in chosen.T:
        found = _grown(surfaces, found, np.arange(len(chosen)), (wall, _whole(surfaces, wall)))
    return found


def _start(anchor: Array) -> Sequences:
    return Sequences(
        surfaces=np.zeros((1, 0), dtype=np.int64),
        images=np.asarray(anchor, dtype=np.float64)[None, None],
        wall=np.array([-1]),
        spans_m=np.zeros((1, 2)),
    )


def _grown(
    surfaces: Surfaces, found: Sequences, row: Indices, bounce: tuple[Indices, Array] | None
) -> Sequences:
    """Sequences of some rows, each with a bounce more: its surface and what of that is lit."""
    taken = Sequences(found.surfaces[row], found.images[row], found.wall[row], found.spans_m[row])
    if bounce is None:
        return taken
    surface, spans = bounce
    image = mirrored(surfaces, taken.images[:, -1], surface)
    slab = surfaces.is_slab[surface]
    return Sequences(
        surfaces=np.column_stack([taken.surfaces, surface]),
        images=np.concatenate([taken.images, image[:, None]], axis=1),
        wall=np.where(slab, taken.wall, surface),
        spans_m=np.where(slab[:, None], taken.spans_m, spans),
    )


def _whole(surfaces: Surfaces, wall: Indices) -> Array:
    return np.stack([np.zeros(len(wall)), surfaces.lengths[wall, 0]], axis=1)


def _any_other(surfaces: Surfaces, found: Sequences) -> tuple[Indices, Indices, Array]:
    """Every surface after every sequence but its last one."""
    follows = np.ones((len(found), len(surfaces)), dtype=bool)
    if found.surfaces.shape[1]:
        follows[np.arange(len(found)), found.surfaces[:, -1]] = False
    row, surface = np.nonzero(follows)
    return row, surface, _whole(surfaces, surface)


def _followers(surfaces: Surfaces, found: Sequences, top_m: float) -> tuple[Indices, Indices, Array]:
    """Sequences' rows, surfaces that they may light, and the parts of these, metres."""
    image = found.images[:, -1]
    row, wall, spans = lit_walls(surfaces, image, found.wall, found.spans_m, top_m)
    slabs = np.flatnonzero(surfaces.is_slab)
    row = np.concatenate([row, np.repeat(np.arange(len(found)), len(slabs))])
    surface = np.concatenate([wall, np.tile(slabs, len(found))])
    spans = np.concatenate([spans, np.zeros((len(surface) - len(wall), 2))])
    height = np.sum((image[row] - surfaces.origin[surface]) * surfaces.normal[surface], axis=-1)
    keep = np.abs(height) > _IN_PLANE_M
    if found.surfaces.shape[1]:
        last = found.surfaces[row, -1]
        arrays = surfaces.corners(), surfaces.normal, surfaces.origin
        keep &= (surface != last) & _in_pyramids(*arrays, image[row], last, surface)
    return row[keep], surface[keep], spans[keep]


@compiled
def _in_pyramids(
    corners: Array, normal: Array, origin: Array, images: Array, last: Indices, surface: Indices
) -> NDArray[np.bool_]:
    """Whether surfaces (q,) may meet the beams from images (q, 3) through the surfaces ``last`` (q,).

    The beam is a pyramid cut off at its surface; what lies outside one of its five planes is dark.
    """
    lit = np.ones(len(images), dtype=np.bool_)
    for row in range(len(images)):
        image, window, target = images[row], corners[last[row]], corners[surface[row]]
        side = np.sign(np.dot(origin[last[row]] - image, normal[last[row]]))
        if side == 0.0:
            continue  # seen edge on: no beam to speak of
        most = -np.inf
        for corner in range(4):
            most = max(most, side * np.dot(target[corner] - origin[last[row]], normal[last[row]]))
        lit[row] = most > TIP
        middle = 0.25 * (window[0] + window[1] + window[2] + window[3]) - image
        for edge in range(4):
            a, b = window[edge] - image, window[(edge + 1) % 4] - image
            plane = np.array(
                [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
            )
            inward = np.sign(np.dot(plane, middle))
            size = max(np.sqrt(np.dot(plane, plane)), TIP)
            most = -np.inf
            for corner in range(4):
                most = max(most, np.dot(target[corner] - image, plane) * inward / size)
            lit[row] = lit[row] and (most > TIP or inward == 0.0)
    return lit
