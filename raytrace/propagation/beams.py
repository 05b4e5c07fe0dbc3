"""Which walls a beam lights: seen from above, walls as high as the paths hide what is behind them.

A beam starts at an image of the anchor and passes the window of the wall that it was last reflected
by. In the coordinates (u, w), where u counts along the window and w is 1 at the window and falls as one over
the distance, walls are straight lines, and what is nearer has the greater w. Bins of u keep the w below
which nothing is seen, as a depth buffer does. A bin is closed where walls cover all of it, so that the
beam reaches every wall that light can reach, and now and then one more: images decide exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from raytrace.propagation.reflectors import RIM_M, TIP, Surfaces

__all__ = ["lit_walls", "within_beams"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Bins of a window; more hide more, and cost in proportion.
_BINS = 256
# So many pieces of walls that cover a part of a bin are kept, the nearest, until others complete them.
_PIECES, _NOTHING = 4, (2.0, -1.0, 0.0)
# An image nearer to its wall's line than this, metres, lights everything beyond, whatever the window.
_FLAT_M = 1e-6
# So much nearer to the window than the image is, a wall is in the window's line.
_IN_LINE = 1e-7


def lit_walls(
    surfaces: Surfaces, images: Array, last: Indices, spans_m: Array, top_m: float
) -> tuple[Indices, Indices, Array]:
    """Walls that beams light, and which part of each.

    Parameters
    ----------
    surfaces : Surfaces
        The surfaces of the plan; floor and ceiling are left out.
    images : ndarray, shape (q, 3)
        Where beams start, metres.
    last : ndarray of int64, shape (q,)
        The wall that reflected each last; -1 for a beam all around.
    spans_m : ndarray, shape (q, 2)
        The part of this wall that it lit, along its first side, metres.
    top_m : float
        No path is higher; walls up to there hide what is behind them. Infinite: no wall does.

    Returns
    -------
    beam, wall : ndarray of int64, shape (pairs,)
    spans_m : ndarray, shape (pairs, 2)
        The part of the wall that is lit, metres; it may be larger than what is lit, never smaller.
    """
    start = surfaces.origin[:, :2].copy()
    step = (surfaces.sides[:, 0] * surfaces.lengths[:, :1])[:, :2]
    opaque = surfaces.lengths[:, 1] >= top_m
    beams, walls, parts = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty((0, 2))]
    window, low, high = np.empty((2, 2)), np.empty(len(start)), np.empty(len(start))
    slab = surfaces.is_slab
    for beam, wall in enumerate(last):
        low[:], high[:] = np.inf, -np.inf
        image = images[beam, :2]
        if wall < 0:  # a beam all around is four, each through a side of a square
            for side in range(4):
                turn = 0.5 * np.pi * (side + np.array([0.0, 1.0]) - 0.5)
                window[:] = image + np.stack([np.cos(turn), np.sin(turn)], axis=1)
                _light(start, step, slab, opaque, image, window, TIP, low, high)
        else:
            rims = spans_m[beam] + np.array([-RIM_M, RIM_M])
            window[:] = start[wall] + rims[:, None] * surfaces.sides[wall, 0, :2]
            gap = abs(float((image - start[wall]) @ surfaces.normal[wall, :2]))
            if gap < _FLAT_M:
                low[~slab], high[~slab] = 0.0, 1.0
            else:
                _light(start, step, slab, opaque, image, window, 1.0, low, high)
            low[wall], high[wall] = np.inf, -np.inf
        lit = np.flatnonzero(high >= low)
        beams.append(np.full(len(lit), beam))
        walls.append(lit)
        parts.append(np.stack([low[lit], high[lit]], axis=1) * surfaces.lengths[lit, :1])
    return np.concatenate(beams), np.concatenate(walls), np.concatenate(parts)


@compiled
def _light(
    start: Array,
    step: Array,
    slab: NDArray[np.bool_],
    opaque: NDArray[np.bool_],
    image: Array,
    window: Array,
    nearest: float,
    low: Array,
    high: Array,
) -> None:
    """Widen the lit shares ``low`` to ``high`` (walls,) of walls by what one beam lights of them.

    ``nearest`` is the distance from which on walls count, in distances of the window.
    """
    clipped = np.empty((len(start), 6))  # u, w and share of the wall at both ends of what lies in the beam
    hidden = np.zeros(_BINS)  # what has a smaller w is not seen
    covered = np.empty((_BINS, _PIECES, 3))  # from, to, and w of what covers parts of a bin
    covered[:] = np.array(_NOTHING)
    ax, ay = window[0] - image
    bx, by = window[1] - image
    area = ax * by - ay * bx
    for wall in range(len(start)):
        clipped[wall, 0] = -1.0
        if slab[wall] or area == 0.0:
            continue
        px, py = start[wall] - image
        qx, qy = step[wall]
        # Shares of the two edges of the window, whose sum is the distance in distances of the window.
        s, ds = (px * (by - ay) - py * (bx - ax)) / area, (qx * (by - ay) - qy * (bx - ax)) / area
        b, db = (ax * py - ay * px) / area, (ax * qy - ay * qx) / area
        one, other = 0.0, 1.0
        for line in range(3):  # beyond the window, and between its edges
            at, slope = (s - nearest, ds) if line == 0 else ((b, db) if line == 1 else (s - b, ds - db))
            slack = TIP * (abs(at) + abs(slope))
            if slope > 0.0:
                one = max(one, (-at - slack) / slope)
            elif slope < 0.0:
                other = min(other, (-at - slack) / slope)
            elif at < -slack:
                other = -1.0
        if one > other:
            continue
        for end, share in ((0, one), (1, other)):
            distance = max(s + share * ds, nearest)
            clipped[wall, 3 * end] = min(1.0, max(0.0, (b + share * db) / distance))
            clipped[wall, 3 * end + 1] = 1.0 / distance
            clipped[wall, 3 * end + 2] = share
        # What lies in the window's own line hides nothing.
        if opaque[wall] and min(clipped[wall, 1], clipped[wall, 4]) * nearest < 1.0 - _IN_LINE:
            _cover(clipped[wall], hidden, covered)
    for wall in range(len(start)):
        if clipped[wall, 0] >= 0.0:
            _widen(clipped[wall], hidden, wall, low, high)


@compiled
def _cover(part: Array, hidden: Array, covered: Array) -> None:
    """Close the bins that a wall covers, alone or with what covered a part of them before."""
    u0, w0, u1, w1 = part[0], part[1], part[3], part[4]
    if u0 > u1:
        u0, w0, u1, w1 = u1, w1, u0, w0
    if u1 - u0 <= TIP:
        return
    slope = (w1 - w0) / (u1 - u0)
    for place in range(int(u0 * _BINS), min(_BINS - 1, int(u1 * _BINS)) + 1):
        left, right = max(u0, place / _BINS), min(u1, (place + 1) / _BINS)
        w = min(w0 + slope * (left - u0), w0 + slope * (right - u0))
        if w <= hidden[place]:
            continue
        farthest = 0
        for piece in range(_PIECES):  # what it touches becomes one with it
            one, other, depth = covered[place, piece]
            if one <= other and left <= other + TIP and right >= one - TIP:
                left, right, w = min(left, one), max(right, other), min(w, depth)
                covered[place, piece] = _NOTHING
            if covered[place, piece, 2] < covered[place, farthest, 2]:
                farthest = piece
        if left <= place / _BINS + TIP and right >= (place + 1) / _BINS - TIP:
            hidden[place] = max(hidden[place], w)
        elif w > covered[place, farthest, 2]:
            covered[place, farthest] = left, right, w


@compiled
def _widen(part: Array, hidden: Array, wall: int, low: Array, high: Array) -> None:
    """Widen the lit share of a wall by what of it lies in bins that do not hide it."""
    u0, w0, t0, u1, w1, t1 = part
    if u0 > u1:
        u0, w0, t0, u1, w1, t1 = u1, w1, t1, u0, w0, t0
    first, last = max(0, int((u0 - TIP) * _BINS)), min(_BINS - 1, int((u1 + TIP) * _BINS))
    if u1 - u0 <= 2.0 / _BINS * TIP:  # seen end on
        for place in range(first, last + 1):
            if max(w0, w1) >= hidden[place] * (1.0 - TIP):
                low[wall], high[wall] = min(low[wall], t0, t1), max(high[wall], t0, t1)
        return
    slope = (w1 - w0) / (u1 - u0)
    for place in range(first, last + 1):
        left, right = max(u0, place / _BINS), min(u1, (place + 1) / _BINS)
        a, b = w0 + slope * (left - u0), w0 + slope * (right - u0)
        if max(a, b) < hidden[place] * (1.0 - TIP):
            continue
        for u, w in ((left, a), (right, b)):
            # The share is linear in u w and in w, which is the distance's inverse.
            share = (u - u0) / (u1 - u0)
            t = t0 + (t1 - t0) * share * w1 / ((1.0 - share) * w0 + share * w1) if w > 0.0 else t0
            low[wall], high[wall] = min(low[wall], t), max(high[wall], t)


@compiled
def within_beams(
    origin: Array,
    sides: Array,
    lengths: Array,
    normal: Array,
    positions: Array,
    images: Array,
    last: Indices,
    wall: Indices,
    spans_m: Array,
    rim_m: float,
) -> tuple[Indices, Indices]:
    """Positions (n, 3) and beams (q,) of which the line to the image meets the last surface, or nearly.

    Parameters
    ----------
    origin, sides, lengths, normal : ndarray
        Of the surfaces.
    positions, images : ndarray, shapes (n, 3) and (q, 3)
        Positions, and where beams start, metres.
    last, wall : ndarray of int64, shape (q,)
        The surface, and the wall, that reflected each last; the wall may be -1.
    spans_m : ndarray, shape (q, 2)
        The part of that wall that was lit, metres.
    rim_m : float
        If it is negative, lines meet that miss by no more, measured across them.

    Returns
    -------
    position, beam : ndarray of int64, shape (pairs,)
    """
    count = 0
    found = np.empty((1024, 2), dtype=np.int64)
    for beam in range(len(images)):
        for place in range(len(positions)):
            near = True
            for look in range(2):
                surface = last[beam] if look == 0 else wall[beam]
                if surface < 0 or (look == 1 and surface == last[beam]):
                    continue
                here, there, towards = 0.0, 0.0, 0.0
                for axis in range(3):
                    here += (positions[place, axis] - origin[surface, axis]) * normal[surface, axis]
                    there += (images[beam, axis] - origin[surface, axis]) * normal[surface, axis]
                    towards += (images[beam, axis] - positions[place, axis]) ** 2
                if (here > 0.0) == (there > 0.0):
                    near = False
                    break
                fraction = here / (here - there)
                margin = RIM_M
                if rim_m < 0.0:
                    margin -= rim_m * np.sqrt(towards) / abs(here - there)
                for side in range(2):
                    along = 0.0
                    for axis in range(3):
                        point = positions[place, axis]
                        point += fraction * (images[beam, axis] - positions[place, axis])
                        along += (point - origin[surface, axis]) * sides[surface, side, axis]
                    lower, upper = 0.0, lengths[surface, side]
                    if surface == wall[beam] and side == 0:
                        lower, upper = spans_m[beam, 0], spans_m[beam, 1]
                    elif look == 1:
                        continue
                    near = near and lower - margin <= along <= upper + margin
                if not near:
                    break
            if near:
                if count == len(found):
                    more = np.empty((2 * count, 2), dtype=np.int64)
                    more[:count] = found
                    found = more
                found[count, 0], found[count, 1] = place, beam
                count += 1
    return found[:count, 0].copy(), found[:count, 1].copy()
