"""Path-to-feature assignments of a candidate place.

The search holds the walls fixed, whose errors exchange paths of similar length. Here every circle of up to
one bounce takes any path near the expected length, or none. Of each place the best ``max_labellings`` are
found by branch and bound, which looks at ``max_labelling_nodes`` partial ones at most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.anchors.circles import Circles
from estimator.slam.anchors.config import AnchorSearchConfig
from estimator.slam.anchors.likelihood import Place, is_behind
from estimator.slam.anchors.search import Candidates, Scene

__all__ = ["labellings", "labellings_at"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def labellings(
    found: Candidates, scene: Scene, length_m: Array, nodes: int, config: AnchorSearchConfig
) -> tuple[Index, Index]:
    """Labels that the present epoch's paths may have, seen from each candidate place.

    Parameters
    ----------
    found : Candidates
        Places.
    scene : Scene
        Where they were found.
    length_m : ndarray, shape (M,)
        Path lengths of the present epoch, in the order that labels refer to.
    nodes : int
        Partial labellings looked at for each place, at most; enough for one labelling are.
    config : AnchorSearchConfig
        Limits.

    Returns
    -------
    candidate : ndarray of int64, shape (V,)
        The candidate of each labelling.
    label : ndarray of int64, shape (V, 1 + L)
        The path of the line of sight and of each wall, -1 for none.
    """
    candidate, label = [], []
    for s in range(len(found)):
        place = Place(
            float(found.mean_m[s, 0]),
            float(found.mean_m[s, 1]),
            float(found.bias_m[s]),
            float(found.height2_m2[s]),
            float(found.height2_std_m2[s]),
        )
        own = labellings_at(
            place,
            scene.circles,
            scene.vrp_m,
            length_m,
            config.labelling_gap_m,
            config.labelling_slack,
            config.max_labellings,
            max(nodes, 2 * scene.circles.walls + 2),
        )
        candidate.append(np.full(len(own), s))
        label.append(own)
    return np.concatenate(candidate), np.concatenate(label)


@compiled
def _options(
    place: Place, circles: Circles, vrp: Array, length: Array, farthest: float
) -> tuple[Index, Index, Array]:
    """What each circle of the last epoch may take, cheapest first: how many, which paths, at what cost."""
    e, count, paths = len(circles.x) - 1, 1 + circles.walls, len(length)
    size = np.empty(count, dtype=np.int64)
    path, cost = np.empty((count, paths + 1), dtype=np.int64), np.empty((count, paths + 1))
    for c in range(count):
        size[c], path[c, 0], cost[c, 0] = 1, -1, 0.0
        if c > 0 and is_behind(place.x, place.y, vrp[c - 1, 0], vrp[c - 1, 1]):
            continue
        dx, dy = place.x - circles.x[e, c], place.y - circles.y[e, c]
        expected = place.bias + np.sqrt(dx * dx + dy * dy + place.height2)
        for j in range(paths):
            gap = length[j] - expected
            if not abs(gap) < farthest:
                continue
            own = 0.5 * gap * gap / (farthest * farthest) - 1.0
            i = size[c]
            while i > 0 and cost[c, i - 1] > own:
                path[c, i], cost[c, i] = path[c, i - 1], cost[c, i - 1]
                i -= 1
            path[c, i], cost[c, i] = j, own
            size[c] += 1
    return size, path, cost


@compiled
def labellings_at(
    place: Place,
    circles: Circles,
    vrp: Array,
    length: Array,
    farthest: float,
    slack: float,
    most: int,
    nodes: int,
) -> Index:
    """The best labellings (V, 1 + L) from one place, best first.

    Parameters
    ----------
    place, circles, vrp
        The place, circles of which the last epoch's count, walls (L, 2).
    length : ndarray, shape (M,)
        Path lengths.
    farthest : float
        From the expected length that a path may be, metres.
    slack : float
        Cost beyond the best labelling's; a path left out costs 1, one taken half its squared gap in units of
        ``farthest``.
    most : int
        Labellings, at most.
    nodes : int
        Partial labellings that are looked at, at most.
    """
    size, path, cost = _options(place, circles, vrp, length, farthest)
    count = len(size)
    rest = np.zeros(count + 1)  # least that the circles from each on can add
    for c in range(count - 1, -1, -1):
        rest[c] = rest[c + 1] + cost[c, 0]
    best, label = np.empty(most), np.empty((most, count), dtype=np.int64)
    best[:] = np.inf
    used = np.zeros(len(length), dtype=np.bool_)
    option, total = np.zeros(count + 1, dtype=np.int64), np.zeros(count + 1)
    kept, looked, c = 0, 0, 0
    while c >= 0 and looked < nodes:
        limit = min(best[0] + slack, best[most - 1])
        if c == count:  # a whole labelling
            if total[c] < limit:
                i = min(kept, most - 1)
                while i > 0 and best[i - 1] > total[c]:
                    best[i] = best[i - 1]
                    for d in range(count):
                        label[i, d] = label[i - 1, d]
                    i -= 1
                best[i] = total[c]
                for d in range(count):
                    label[i, d] = path[d, option[d] - 1]
                kept = min(kept + 1, most)
            c -= 1
            if path[c, option[c] - 1] >= 0:
                used[path[c, option[c] - 1]] = False
            continue
        if option[c] < size[c] and total[c] + cost[c, option[c]] + rest[c + 1] < limit:
            looked += 1
            j = path[c, option[c]]
            option[c] += 1
            if j >= 0 and used[j]:
                continue
            if j >= 0:
                used[j] = True
            total[c + 1] = total[c] + cost[c, option[c] - 1]
            c += 1
            if c < count:
                option[c] = 0
            continue
        c -= 1
        if c >= 0 and path[c, option[c] - 1] >= 0:
            used[path[c, option[c] - 1]] = False
    while kept > 1 and not best[kept - 1] < best[0] + slack:
        kept -= 1
    return label[:kept]
