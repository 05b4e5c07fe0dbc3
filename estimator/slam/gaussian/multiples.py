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

from collections.abc import Sequence
from functools import cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from estimator.slam.config import GaussianConfig
from estimator.slam.features import Complex, plane, plane_side, reflect
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


def multiple_lengths(agent: Array, device: Array, walls: Array) -> Array:
    """Lengths of all paths over two and three walls.

    Parameters
    ----------
    agent : ndarray, shape (..., N, 2)
        Places of the agent, gauge frame, metres.
    device : ndarray, shape (..., 4)
        An anchor in the state vector: position, squared height difference, clock bias.
    walls : ndarray, shape (..., L, 2)
        VRPs; NaN of walls that no path goes over.

    Returns
    -------
    ndarray, shape (..., N, S)
        Metres; infinity where the bounces are impossible even if the walls had no ends.
    """
    vrp, place, anchor = plane(walls), plane(agent)[..., None], plane(device[..., :2])[..., None, None]
    size = np.abs(vrp)
    with np.errstate(invalid="ignore"):  # of walls that no path goes over
        towards, turn = (vrp / size).conj(), vrp / vrp.conj()

    def side(point: Complex, wall: NDArray[np.int64]) -> Array:
        """Signed distance from walls, negative on RP's side."""
        return plane_side(point, towards[..., None, wall], 0.5 * size[..., None, wall])

    lengths = [np.empty((*agent.shape[:-1], 0))]
    for order in _ORDERS:
        sequence = _sequences(walls.shape[-2], order)
        image = [anchor]
        for wall in sequence.T:
            image.append(vrp[..., None, wall] - turn[..., None, wall] * image[-1].conj())
        point, possible = place, np.ones((*agent.shape[:-1], len(sequence)), dtype=bool)
        # from the agent back to the anchor
        for wall, source in zip(sequence.T[::-1], image[:0:-1], strict=True):
            here, there = side(point, wall), side(source, wall)
            possible &= here * there < 0.0
            point = point + here / np.where(here == there, np.inf, here - there) * (source - point)
        lengths.append(np.where(possible, _length(place - image[-1], device), np.inf))
    return np.concatenate(lengths, axis=-1)


def _length(offset: Complex, device: Array) -> Array:
    """Path lengths (..., N, S) of horizontal offsets from anchors (..., 4) in the state vector."""
    square = offset.real**2 + offset.imag**2 + device[..., None, None, 2]
    return np.asarray(np.sqrt(np.maximum(square, 1e-6)) + device[..., None, None, 3])


def redundant_walls(states: Sequence[GaussianState], config: GaussianConfig) -> NDArray[np.bool_]:
    """Walls (B, L) found on the way of which paths over the other found walls explain all that was heard.

    A wall is compared with the others at the two ends of the stretch of track on which each anchor
    heard it. Walls are taken away one after the other, the youngest first: what explains another must stay.

    Parameters
    ----------
    states : sequence of GaussianState
        States of B runs with one layout, of shared walls.
    config : GaussianConfig
        ``pair_radius_m``.
    """
    layout = states[0].layout
    mean = np.array([state.rows.mean[state.rows.best] for state in states])
    device = mean[:, layout.FIRST_ANCHOR : layout.walls.start].reshape(len(mean), layout.anchors, -1)
    vrp = mean[:, layout.walls].reshape(len(mean), layout.slots, 2)
    heard_from = np.array([state.slots.heard_from_m for state in states])  # (B, L, K, 2, 2)
    born = np.array([state.slots.born for state in states])
    found = np.array([state.slots.confirmed & state.rows.present[state.rows.best] for state in states])
    gone = np.zeros(found.shape, dtype=bool)
    asked = found & (born >= 0)
    youngest = np.argsort(np.where(asked, -born, 1), axis=1, kind="stable")
    for column in youngest.T[: int(np.max(asked.sum(axis=1)))]:
        run = np.flatnonzero(asked[np.arange(len(mean)), column])
        slot = column[run]
        found[run, slot] = False
        places = heard_from[run, slot]  # (N, K, 2, 2)
        others = np.where(found[run, :, None], vrp[run], np.nan)[:, None]
        explained = _explained(places, device[run], vrp[run, None, slot], others, config)
        heard = np.isfinite(places[..., 0, 0])
        gone[run, slot] = heard.any(axis=1) & np.all(explained | ~heard, axis=1)
        found[run, slot] = ~gone[run, slot]
    return gone


def _explained(
    agent: Array, device: Array, wall: Array, others: Array, config: GaussianConfig
) -> NDArray[np.bool_]:
    """Whether (N, K) a path over the same other walls is as long as that over ``wall`` at all places.

    In a right corner the order of the bounces changes along the way, and the length does not tell it.

    Parameters
    ----------
    agent : ndarray, shape (N, K, P, 2)
        Places, NaN if an anchor has not heard the wall.
    device, wall, others : ndarray, shapes (N, K, 4), (N, 1, 2) and (N, 1, L, 2)
        Anchors, walls, and for each wall the others, NaN for those that there are not.
    """
    image = plane(reflect(device[..., :2], wall))[..., None, None]
    own = _length(plane(agent)[..., None] - image, device)
    near = np.abs(multiple_lengths(agent, device, others) - own) < config.pair_radius_m
    families = near @ _families(others.shape[-2])
    return np.asarray(np.any(np.all(families, axis=-2), axis=-1))
