"""Where an anchor can be, given one path length: circles round the agent and round its images.

A mirror keeps lengths, so the path that leaves the anchor and bounces off wall ``l``
is as long as the straight way from the anchor to the *agent's* image in ``l``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.slam.features import reflect

__all__ = ["Centres", "images_of_agent", "intersections"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Centres:
    """Circle centres of one or more epochs.

    Parameters
    ----------
    point_m : ndarray, shape (C, 2)
        The agent and its images.
    covariance_m2 : ndarray, shape (C, 2, 2)
        Their covariances.
    bounces : ndarray of int64, shape (C,)
        0 for the agent, 1 for an image in a wall, 2 for an image of an image.
    epoch : ndarray of int64, shape (C,)
        The epoch it belongs to.
    wall, behind : ndarray of int64, shape (C,)
        Wall of the first image and of the second, -1 where there is none.
    """

    point_m: Array
    covariance_m2: Array
    bounces: NDArray[np.int64]
    epoch: NDArray[np.int64]
    wall: NDArray[np.int64]
    behind: NDArray[np.int64]


def images_of_agent(
    position: Array,
    position_variance: float,
    walls: Array,
    wall_covariance: Array,
    slots: NDArray[np.int64],
    epoch: int,
) -> Centres:
    """The agent and its images in the walls, up to two bounces.

    Parameters
    ----------
    position : ndarray, shape (2,)
        Agent, gauge frame, metres.
    position_variance : float
        Its variance per axis, square metres.
    walls : ndarray, shape (L, 2)
        VRPs.
    wall_covariance : ndarray, shape (L, 2, 2)
        Their covariances.
    slots : ndarray of int64, shape (L,)
        Numbers to give the walls.
    epoch : int
        Number of the epoch.
    """
    count = len(walls)
    first = reflect(np.broadcast_to(position, (count, 2)), walls)
    own = position_variance * np.eye(2)
    covariance = own + wall_covariance
    # from the anchor over a near, then a far wall: the image in the near of the image in the far
    near, far = np.nonzero(~np.eye(count, dtype=bool))
    second = reflect(first[far], walls[near])
    none = np.full(1, -1)
    return Centres(
        np.concatenate([position[None], first, second]),
        np.concatenate([own[None], covariance, covariance[near] + wall_covariance[far]]),
        np.repeat([0, 1, 2], [1, count, near.size]),
        np.full(1 + count + near.size, epoch),
        np.concatenate([none, slots, slots[near]]),
        np.concatenate([none, np.full(count, -1), slots[far]]),
    )


def intersections(centres: Array, radii: Array) -> Array:
    """Intersections (P, 2, 2) of pairs of circles, centres (P, 2, 2) and radii (P, 2); NaN if apart."""
    offset = centres[:, 1] - centres[:, 0]
    distance = np.linalg.norm(offset, axis=1)
    distance = np.where(distance > 1e-6, distance, np.nan)
    along = (distance**2 + radii[:, 0] ** 2 - radii[:, 1] ** 2) / (2.0 * distance)
    height2 = radii[:, 0] ** 2 - along**2
    height = np.sqrt(np.where(height2 > -1.0, np.maximum(height2, 0.0), np.nan))
    unit = offset / distance[:, None]
    foot = centres[:, 0] + along[:, None] * unit
    side = np.stack([-unit[:, 1], unit[:, 0]], axis=1) * height[:, None]
    return np.stack([foot + side, foot - side], axis=1)
