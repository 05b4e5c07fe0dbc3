"""A wall cut into parts of one material each, where the losses of its reflections ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from raytrace.propagation.slab_fit import SlabFit, SlabSearch, fit_slab

__all__ = ["Losses", "WallPart", "wall_parts"]

Array = NDArray[np.float64]
_LEAST_BOUNCES = 3  # fewer tell no material
_MOST_SAMPLES = 10_000  # evidence of the whole and of its parts has to be of the same losses


@dataclass(frozen=True, eq=False)
class Losses:
    """Single bounces off one wall.

    Parameters
    ----------
    along_m : ndarray, shape (N,)
        Distance of each bounce from the wall's first end.
    vertex_m : ndarray, shape (N, 3, 3)
        Anchor, bounce and agent.
    loss_db, noise_db : ndarray, shape (N,)
        Loss beyond free space and its standard deviation.
    """

    along_m: Array
    vertex_m: Array
    loss_db: Array
    noise_db: Array

    def between(self, first_m: float, last_m: float) -> Losses:
        """Those of a part."""
        mine = (self.along_m >= first_m) & (self.along_m <= last_m)
        return Losses(self.along_m[mine], self.vertex_m[mine], self.loss_db[mine], self.noise_db[mine])


@dataclass(frozen=True)
class WallPart:
    """A part of a wall, from and to distances from its first end, and what it is made of; None if unheard."""

    from_m: float
    to_m: float
    fit: SlabFit | None


def wall_parts(
    length_m: float,
    cuts_m: Sequence[float],
    losses: Losses,
    carrier_hz: float,
    search: SlabSearch | None = None,
) -> list[WallPart]:
    """Cut a wall where another wall meets it, if its parts are made of different slabs.

    Neighbours are joined while one slab explains both as well as two would: evidence weighs the fewer
    parameters.
    Parts that nothing was heard of take after their neighbours.

    Parameters
    ----------
    length_m : float
        Of the wall.
    cuts_m : sequence of float
        Where it may change, as distances from its first end.
    losses : Losses
        What was heard of it.
    carrier_hz : float
        Carrier frequency.
    search : SlabSearch, optional
        How slabs are compared.
    """
    bounds = [0.0, *sorted(cut for cut in cuts_m if 0.0 < cut < length_m), length_m]
    parts: list[WallPart] = []
    for first, last in pairwise(bounds):
        part = WallPart(first, last, _fit(losses.between(first, last), carrier_hz, search))
        if parts and (parts[-1].fit is None or part.fit is None):
            parts[-1] = WallPart(parts[-1].from_m, last, parts[-1].fit or part.fit)
            continue
        if parts:
            both = _fit(losses.between(parts[-1].from_m, last), carrier_hz, search)
            apart = _evidence(parts[-1].fit) + _evidence(part.fit)
            if both is not None and both.log_evidence >= apart:
                parts[-1] = WallPart(parts[-1].from_m, last, both)
                continue
        parts.append(part)
    return parts


def _fit(losses: Losses, carrier_hz: float, search: SlabSearch | None) -> SlabFit | None:
    if len(losses.loss_db) < _LEAST_BOUNCES:
        return None
    search = search or SlabSearch(most_samples=_MOST_SAMPLES)
    return fit_slab(losses.vertex_m, losses.loss_db, losses.noise_db, carrier_hz, search)


def _evidence(fit: SlabFit | None) -> float:
    return 0.0 if fit is None else fit.log_evidence
