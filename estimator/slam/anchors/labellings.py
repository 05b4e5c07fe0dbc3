"""Which path of an epoch came which way, if an anchor stands about there: all labellings that may be."""

from __future__ import annotations

from itertools import islice, product

import numpy as np
from numpy.typing import NDArray

from estimator.slam.anchors.circles import Centres
from estimator.slam.anchors.search import Candidates
from estimator.slam.features import wall_side

__all__ = ["labellings"]

Array = NDArray[np.float64]
_MOST_LABELLINGS, _KEPT_LABELLINGS = 4096, 24  # tried, and kept, of each candidate place
_WORSE = 1.2  # than the best: a path left out counts 1, and errors as their squares say
_ALIKE_M = 3.0  # lengths that the walls' errors may exchange


def labellings(
    found: Candidates, centres: Centres, length: Array, walls: dict[int, Array]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Labels that this epoch's paths may have, seen from each candidate place.

    The candidates' own labels hold the walls fixed, whose errors exchange paths of similar length. Here
    every centre takes any path near the expected length, or none.

    Parameters
    ----------
    found : Candidates
        Places, shape (S, 2).
    centres : Centres
        This epoch's, of up to one bounce.
    length : ndarray, shape (M,)
        Path lengths.
    walls : dict of int to ndarray, shape (2,)
        VRPs.

    Returns
    -------
    candidate : ndarray of int64, shape (V,)
        The candidate of each labelling.
    label : ndarray of int64, shape (V, C)
        The path of each centre, -1 for none.
    """
    gap = (
        length
        - found.bias_m[:, None, None]
        - np.linalg.norm(found.mean_m[:, None] - centres.point_m, axis=-1)[..., None]
    )
    near = np.abs(gap) < _ALIKE_M  # (S, C, M)
    for c in np.flatnonzero(centres.wall >= 0):
        near[:, c] &= (wall_side(found.mean_m, walls[int(centres.wall[c])]) < 0.0)[:, None]
    candidate, label = [], []
    for s in range(len(gap)):
        options = [[-1, *np.flatnonzero(row).tolist()] for row in near[s]]
        rated = []
        for chosen in islice(product(*options), _MOST_LABELLINGS):
            used = [j for j in chosen if j >= 0]
            if len(set(used)) == len(used):
                off = sum(gap[s, c, j] ** 2 for c, j in enumerate(chosen) if j >= 0)
                rated.append((0.5 * off / _ALIKE_M**2 - len(used), chosen))
        least = min(rated)[0] + _WORSE
        for _, chosen in sorted(each for each in rated if each[0] < least)[:_KEPT_LABELLINGS]:
            candidate.append(s)
            label.append(chosen)
    return np.array(candidate), np.array(label)
