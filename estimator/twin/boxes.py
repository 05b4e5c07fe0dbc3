"""Upright boxes in the plane, and the straight legs of paths that cross them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Legs", "crosses_box"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Legs:
    """Legs of paths.

    Parameters
    ----------
    ends_m : ndarray, shape (N, 2, 2)
        Both ends of each.
    path : ndarray of int64, shape (N,)
        The path that it belongs to.
    weight : ndarray, shape (N,)
        How far it counts.
    """

    ends_m: Array
    path: NDArray[np.int64]
    weight: Array

    def joined(self, other: Legs) -> Legs:
        """These and others, whose paths are none of these."""
        first = int(self.path.max(initial=-1)) + 1
        return Legs(
            np.concatenate([self.ends_m, other.ends_m]),
            np.concatenate([self.path, first + other.path]),
            np.concatenate([self.weight, other.weight]),
        )

    def select(self, mask: Mask) -> Legs:
        """The legs of a mask (N,)."""
        return Legs(self.ends_m[mask], self.path[mask], self.weight[mask])


def crosses_box(ends_m: Array, box: Array) -> Mask:
    """Which legs (N, 2, 2) run through the inside of a box (xmin, ymin, xmax, ymax), shape (N,)."""
    start, along = ends_m[:, 0], ends_m[:, 1] - ends_m[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (box[:2] - start) / along, (box[2:] - start) / along
    inside = (start > box[:2]) & (start < box[2:])
    still = along == 0.0
    near = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(one, other))
    far = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(one, other))
    return np.asarray(np.maximum(near.max(axis=1), 0.0) < np.minimum(far.min(axis=1), 1.0))
