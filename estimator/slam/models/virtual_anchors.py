"""Virtual anchors as features: points that each anchor has for itself, and the walls that they imply.

The path of a virtual anchor is as long as the straight line from it to the agent, whatever
walls stand between, and however many bounces it stands for. So its length depends on the agent and on that
point alone, and on nothing that another anchor knows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import vrp_of_image
from estimator.slam.models.state_vector import FIRST_ANCHOR, PER_ANCHOR, Layout

__all__ = ["VirtualAnchors", "implied_walls"]

Array = NDArray[np.float64]


class VirtualAnchors(NamedTuple):
    """The slots of R state vectors that hold virtual anchors (:mod:`estimator.slam.models.state_vector`).

    Parameters
    ----------
    point_m : ndarray, shape (R, L, 2)
        The virtual anchors, gauge frame, metres.
    by_slot : ndarray, shape (R, L, 2, 2)
        Derivatives of the points by distance and bearing.
    anchor_m : ndarray, shape (R, K, 2)
        The physical anchors.
    """

    point_m: Array
    by_slot: Array
    anchor_m: Array

    @classmethod
    def of(cls, mean: Array, layout: Layout) -> VirtualAnchors:
        """Those of state vectors (R, n)."""
        devices = mean[:, FIRST_ANCHOR : layout.walls.start].reshape(len(mean), layout.anchors, PER_ANCHOR)
        slots = mean[:, layout.walls].reshape(len(mean), layout.slots, layout.per_slot)
        distance, bearing = slots[..., 0], slots[..., 1]
        outward = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        across = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)
        point = slots[..., 2:4] + distance[..., None] * outward
        by_slot = np.stack([outward, distance[..., None] * across], axis=-1)
        return cls(point, by_slot, devices[..., 0:2])


def implied_walls(mean: Array, layout: Layout, owner: NDArray[np.int64]) -> Array:
    """VRPs (R, L, 2) of the walls that the slots hold or, as virtual anchors, imply.

    Parameters
    ----------
    mean : ndarray, shape (R, n)
        State vectors.
    layout : Layout
        Positions in them.
    owner : ndarray of int64, shape (L,)
        The anchor whose virtual anchor each slot holds; of empty slots anything.
    """
    if layout.shared:
        return mean[:, layout.walls].reshape(len(mean), layout.slots, 2)
    places = VirtualAnchors.of(mean, layout)
    return vrp_of_image(places.point_m, places.anchor_m[:, owner])
