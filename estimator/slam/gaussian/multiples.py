"""Paths over two and three known walls, and the walls that they would be taken for.

A path over several walls is as long as a path over one wall that is not there: the image of an image
is the image of the anchor in *some* line. Where all the walls are known such paths are predicted, and must
start no wall. Often they come first: a double bounce is heard while one of its walls is still to be
found, and everything that this one path tells fits the wall that is not there. Once the other wall is
found the deception shows: wherever the wall was heard, and from every anchor that heard it,
a path over other walls is as long.

Third bounces only explain away; as measurements they are too weak and too many.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import reflect, wall_side
from estimator.slam.gaussian.state import GaussianState

__all__ = ["multiple_lengths", "redundant_walls"]

Array = NDArray[np.float64]
_ORDERS = (2, 3)  # bounces; the fourth is below what is heard


@cache
def _sequences(walls: int, order: int) -> NDArray[np.int64]:
    """All sequences (S, order) of walls in which none follows itself."""
    rows = [row for row in product(range(walls), repeat=order) if all(a != b for a, b in pairwise(row))]
    return np.array(rows, dtype=np.int64).reshape(-1, order)


@cache
def _families(walls: int) -> NDArray[np.bool_]:
    """Which sequences of all orders are the same walls in another order, (S, families)."""
    walls_of = [tuple(sorted(row)) for order in _ORDERS for row in _sequences(walls, order).tolist()]
    kinds = list(dict.fromkeys(walls_of))
    same = [[own == kind for kind in kinds] for own in walls_of]
    return np.array(same, dtype=bool).reshape(len(walls_of), len(kinds))


def _length(offset: Array, device: Array) -> Array:
    """Path lengths (...) of horizontal offsets (..., 2) from an anchor in the state vector."""
    square = np.sum(offset * offset, axis=-1) + device[2]
    return np.asarray(np.sqrt(np.maximum(square, 1e-6)) + device[3])


def multiple_lengths(agent: Array, device: Array, walls: Array) -> Array:
    """Lengths of all paths over two and three walls.

    Parameters
    ----------
    agent : ndarray, shape (N, 2)
        Places of the agent, gauge frame, metres.
    device : ndarray, shape (4,)
        An anchor in the state vector: position, squared height difference, clock bias.
    walls : ndarray, shape (L, 2)
        VRPs.

    Returns
    -------
    ndarray, shape (N, S)
        Metres; infinity where the bounces are impossible even if the walls had no ends.
    """
    lengths = [np.empty((len(agent), 0))]
    for order in _ORDERS:
        sequence = walls[_sequences(len(walls), order)]  # (S, order, 2)
        image = [np.broadcast_to(device[:2], (len(sequence), 2))]
        for bounce in range(order):
            image.append(reflect(image[-1], sequence[:, bounce]))
        length = _length(agent[:, None] - image[-1], device)
        point = np.broadcast_to(agent[:, None], (*length.shape, 2))
        possible = np.ones(length.shape, dtype=bool)
        for bounce in reversed(range(order)):  # from the agent back to the anchor
            wall, source = sequence[:, bounce], image[bounce + 1]
            side, other = wall_side(point, wall), wall_side(source, wall)
            possible &= side * other < 0.0
            fraction = side / np.where(side == other, np.inf, side - other)
            point = point + fraction[..., None] * (source - point)
        lengths.append(np.where(possible, length, np.inf))
    return np.concatenate(lengths, axis=1)


def redundant_walls(state: GaussianState, config: GaussianConfig) -> NDArray[np.int64]:
    """Slots of walls found on the way of which paths over the other found walls explain all that was heard.

    A wall is compared with the others at the two ends of the stretch of track on which each anchor
    heard it. Walls are taken away one after the other, the youngest first: what explains another must stay.

    Parameters
    ----------
    state : GaussianState
        State of shared walls.
    config : GaussianConfig
        ``pair_radius_m``.
    """
    layout, slots = state.layout, state.slots
    best = state.rows.best
    mean = state.rows.mean[best]
    vrp = mean[layout.walls].reshape(-1, 2)
    found = slots.confirmed & state.rows.present[best]
    gone: list[int] = []
    for slot in sorted(np.flatnonzero(found & (slots.born >= 0)).tolist(), key=lambda s: -slots.born[s]):
        others = vrp[found & (np.arange(len(vrp)) != slot)]
        heard = np.flatnonzero(np.isfinite(slots.heard_from_m[slot, :, 0, 0]))
        if heard.size and all(
            _explained(slots.heard_from_m[slot, k], mean[layout.anchor(k)], vrp[slot], others, config)
            for k in heard.tolist()
        ):
            gone.append(slot)
            found[slot] = False
    return np.array(gone, dtype=np.int64)


def _explained(agent: Array, device: Array, wall: Array, others: Array, config: GaussianConfig) -> bool:
    """Whether a path over the same other walls is as long as that over ``wall`` at all places of the agent.

    In a right corner the order of the bounces changes along the way, and the length does not tell it.
    """
    own = _length(agent - reflect(device[:2], wall), device)
    gap = np.abs(multiple_lengths(agent, device, others) - own[:, None])
    families = (gap < config.pair_radius_m) @ _families(len(others))
    return bool(np.any(np.all(families, axis=0)))
