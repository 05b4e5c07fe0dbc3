"""Virtual anchors told as the walls that they imply, (3), each wall once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import vrp_by_image, vrp_of_image
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.models.hypotheses import moments
from estimator.slam.models.virtual_anchors import VirtualAnchors

__all__ = ["Wall", "virtual_walls"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Wall:
    """A wall that counts as found.

    Parameters
    ----------
    wall_id : int
        Its identity.
    mean_m, covariance_m2 : ndarray, shapes (2,) and (2, 2)
        Its VRP.
    existence : float
        Probability that it stands there.
    """

    wall_id: int
    mean_m: Array
    covariance_m2: Array
    existence: float


def virtual_walls(state: GaussianState, weight: Array, same_m: float) -> list[Wall]:
    """The walls that the virtual anchors found imply, in the order of their identities.

    A virtual anchor is told where the likeliest hypothesis has it. A wall that several anchors found is given
    once, under its first identity, as the one that knows it best. Several bounces imply a wall too, where
    none is.

    Parameters
    ----------
    state : GaussianState
        State whose slots hold virtual anchors.
    weight : ndarray, shape (R,)
        Probabilities of its hypotheses.
    same_m : float
        Walls closer than this are one, metres.
    """
    hypotheses, layout, best = state.hypotheses, state.layout, int(np.argmax(weight))
    places = VirtualAnchors.of(hypotheses.mean, layout)
    anchor = places.anchor_m[:, state.slots.owner]
    vrp = vrp_of_image(places.point_m, anchor)
    linear = vrp_by_image(places.point_m, anchor) @ places.by_slot  # (R, L, 2, 2)
    free = layout.walls.start + layout.per_slot * np.arange(layout.slots)[:, None] + np.arange(2)
    covariance = (
        linear @ hypotheses.covariance[:, free[:, :, None], free[:, None, :]] @ linear.swapaxes(-1, -2)
    )
    away = places.point_m - places.point_m[best]
    there = hypotheses.present & (away[..., 0] ** 2 + away[..., 1] ** 2 < same_m**2)
    chance = weight @ there
    walls: list[Wall] = []
    for slot in np.flatnonzero(state.slots.confirmed & hypotheses.present[best]).tolist():
        share = weight * there[:, slot] / chance[slot]
        mean, spread = moments(share, vrp[:, slot], covariance[:, slot])
        _add(walls, same_m, Wall(int(state.slots.wall_id[slot]), mean, spread, min(float(chance[slot]), 1.0)))
    return sorted(walls, key=lambda wall: wall.wall_id)


def _add(walls: list[Wall], same_m: float, wall: Wall) -> None:
    """Append a wall, or make it one with the wall that is already there."""
    for i, other in enumerate(walls):
        if np.linalg.norm(wall.mean_m - other.mean_m) < same_m:
            better = min(wall, other, key=lambda each: float(np.trace(each.covariance_m2)))
            first, existence = min(wall.wall_id, other.wall_id), max(wall.existence, other.existence)
            walls[i] = Wall(first, better.mean_m, better.covariance_m2, existence)
            return
    walls.append(wall)
