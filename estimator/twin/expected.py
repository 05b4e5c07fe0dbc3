"""Paths that walls with ends would give, whatever else stands in the way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import segments_cross
from estimator.twin.stretches import Stretch
from estimator.twin.unfolding import Unfolded, line_frames

__all__ = ["expected_paths"]

Array = NDArray[np.float64]


def expected_paths(paths: Unfolded, vrps_m: Array, walls: Sequence[Stretch]) -> NDArray[np.bool_]:
    """Which unfolded paths (T, K, F) bounce on wall alone and cross none.

    Parameters
    ----------
    paths : Unfolded
        Paths over lines without ends.
    vrps_m : ndarray, shape (L, 2)
        The lines.
    walls : sequence of Stretch
        Where there is wall: on lines, and (line -1) between them.
    """
    foot, tangent, _ = line_frames(vrps_m)
    good = paths.possible.copy()
    on = paths.walls < 0
    on = np.broadcast_to(on, paths.bounce_m.shape).copy()
    for wall in walls:
        if wall.line < 0:
            continue
        low, high = np.sort((wall.ends_m - foot[wall.line]) @ tangent[wall.line])
        mine = (paths.walls == wall.line) & (paths.bounce_m >= low) & (paths.bounce_m <= high)
        on |= mine
        crossing = paths.crossing_m[..., wall.line]
        good &= ~np.any((crossing > low) & (crossing < high), axis=-1)
    good &= on.all(axis=-1)
    for wall in walls:
        if wall.line >= 0:
            continue
        legs = paths.vertex_m
        for leg in range(3):
            good &= ~segments_cross(
                legs[..., leg, :], legs[..., leg + 1, :], wall.ends_m[0], wall.ends_m[1], 1e-6
            )
    return good
