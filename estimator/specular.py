"""Specular paths in the plane: line of sight and mirror images with visibility.

The walls are straight segments that reflect on both sides and block everything.
A path over walls ``l`` and ``m`` (from the anchor to the agent) is valid when each
bounce falls on its segment and no leg crosses a wall. Used to simulate measurements
and to bound what any estimator can reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.geometry import mirror_in_wall, segments_cross

__all__ = ["SpecularPaths", "specular_paths"]


@dataclass(frozen=True, eq=False)
class SpecularPaths:
    """Candidate paths of every anchor to every position.

    Parameters
    ----------
    walls : tuple of tuple of int
        Wall sequence of each candidate, from the anchor to the agent; () is the line of sight.
    length_m : ndarray, shape (T, K, F)
        Path lengths, metres, whether valid or not.
    visible : ndarray of bool, shape (T, K, F)
        Whether the path exists.
    azimuth_rad : ndarray, shape (T, K, F)
        Direction of arrival: of the source (the anchor or its image) seen from the agent.
    """

    walls: tuple[tuple[int, ...], ...]
    length_m: NDArray[np.float64]
    visible: NDArray[np.bool_]
    azimuth_rad: NDArray[np.float64]


def _clear(
    a: NDArray[np.float64], b: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the legs from ``a`` to ``b`` (..., 2) cross none of the walls (L, 2)."""
    crossed = segments_cross(a[..., None, :], b[..., None, :], start, end)
    return np.asarray(~np.any(crossed, axis=-1))


def specular_paths(
    start_m: ArrayLike, end_m: ArrayLike, anchors_m: ArrayLike, positions_m: ArrayLike, order: int = 1
) -> SpecularPaths:
    """Trace all paths of up to ``order`` bounces.

    Parameters
    ----------
    start_m, end_m : array_like, shape (L, 2)
        End points of the walls, metres.
    anchors_m : array_like, shape (K, 2)
        Anchors, metres.
    positions_m : array_like, shape (T, 2)
        Agent positions, metres.
    order : int
        Largest number of bounces, 0 or more.

    Returns
    -------
    SpecularPaths
    """
    start = np.asarray(start_m, dtype=np.float64).reshape(-1, 2)
    end = np.asarray(end_m, dtype=np.float64).reshape(-1, 2)
    anchors = np.asarray(anchors_m, dtype=np.float64).reshape(-1, 2)
    positions = np.asarray(positions_m, dtype=np.float64).reshape(-1, 2)
    if start.shape != end.shape:
        raise InputError(f"end_m: expected shape {start.shape} as start_m has, got {end.shape}")
    if order < 0:
        raise InputError(f"order: expected 0 or more bounces, got {order}")
    sequences: list[tuple[int, ...]] = []
    lengths, visible, azimuths = [], [], []
    for bounces in range(order + 1):
        for sequence in _sequences(len(start), bounces):
            offset, seen = _trace(sequence, start, end, anchors, positions)
            sequences.append(sequence)
            lengths.append(np.linalg.norm(offset, axis=-1))
            azimuths.append(np.arctan2(offset[..., 1], offset[..., 0]))
            visible.append(seen)
    columns = (np.stack(column, axis=-1) for column in (lengths, visible, azimuths))
    return SpecularPaths(tuple(sequences), *columns)


def _sequences(walls: int, bounces: int) -> list[tuple[int, ...]]:
    """Wall sequences without the same wall twice in a row."""
    if bounces <= 2:
        return list(permutations(range(walls), bounces))
    shorter = _sequences(walls, bounces - 1)
    return [(*s, wall) for s in shorter for wall in range(walls) if wall != s[-1]]


def _trace(
    sequence: tuple[int, ...],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    anchors: NDArray[np.float64],
    positions: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Way to the source (T, K, 2) and validity (T, K) of one wall sequence, by the image method."""
    images = [anchors]
    for wall in sequence:
        images.append(mirror_in_wall(images[-1], start[wall], end[wall]))
    shape = (len(positions), len(anchors), 2)
    point = np.broadcast_to(positions[:, None, :], shape)
    offset = images[-1][None] - point
    seen = np.ones(shape[:2], dtype=bool)
    for wall, image in zip(reversed(sequence), reversed(images[1:]), strict=True):
        target = np.broadcast_to(image[None], shape)
        seen &= segments_cross(point, target, start[wall], end[wall], margin=0.0)
        along = end[wall] - start[wall]
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        before, after = (point - start[wall]) @ normal, (target - start[wall]) @ normal
        fraction = before / np.where(before == after, 1.0, before - after)
        bounce = point + fraction[..., None] * (target - point)
        others = [i for i in range(len(start)) if i != wall]
        seen &= _clear(point, bounce, start[others], end[others])
        point = bounce
    last = [i for i in range(len(start)) if not sequence or i != sequence[0]]
    seen &= _clear(point, np.broadcast_to(anchors[None], shape), start[last], end[last])
    return offset, seen
