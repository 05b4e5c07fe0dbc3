"""Flashes of a sweep and walls: matched one by one, the best pair first, the Gaussian corrected after each.

A flash is a known wall's, a new wall's, or a double bounce over two known walls. Time is that of the flashes
squared times the walls, and of the flashes times the pairs of walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.models.directions import wrapped
from estimator.slam.models.features import mirror
from estimator.slam.models.kalman import projected, scalar_update
from estimator.slam.models.state_vector import ECHO_BIAS, FIRST_ANCHOR, PER_ANCHOR, THETA, Layout
from estimator.slam.models.sweeps import FLASH_ENTRIES, flash_of

__all__ = ["MatchModel", "are_double_bounces", "double_bounce", "flash_cost", "heading_of", "match_flashes"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class MatchModel(NamedTuple):
    """What compiled matching needs to know: fields of :class:`SweepMatching`, and the polar correction's."""

    gate_sigma: float
    new_density: float
    square_share: float
    square_std_rad: float
    heading_scale_m: float
    ghost_flashes: float
    ghost_std_m: float
    ghost_azimuth_rad: float
    rival_nats: float
    most_turn_rad: float


@compiled
def heading_of(
    layout: Layout, mean: Array, present: NDArray[np.bool_], seen: Array, noise: Array, scale_m: float
) -> float:
    """The turn of the agent's axes that fits a sweep best: each pairing proposes, distances vote."""
    index, value = np.empty(FLASH_ENTRIES, dtype=np.int64), np.empty((2, FLASH_ENTRIES))
    flash = np.empty((layout.slots, 2))
    for i in range(layout.slots):
        x, y = flash_of(layout, mean, i, index, value)
        flash[i, 0], flash[i, 1] = x, y
    best, least = 0.0, np.inf
    for a in range(seen.shape[0]):
        for b in range(layout.slots):
            if not present[b]:
                continue
            turn = np.arctan2(seen[a, 1], seen[a, 0]) - np.arctan2(flash[b, 1], flash[b, 0])
            c, s = np.cos(turn), np.sin(turn)
            score = 0.0
            for j in range(seen.shape[0]):
                x, y = c * seen[j, 0] + s * seen[j, 1], c * seen[j, 1] - s * seen[j, 0]
                nearest = np.inf
                for i in range(layout.slots):
                    if present[i]:
                        nearest = min(nearest, np.hypot(x - flash[i, 0], y - flash[i, 1]))
                scale = np.sqrt(0.5 * (noise[j, 0, 0] + noise[j, 1, 1])) + scale_m
                score += min((nearest / scale) ** 2, 16.0)
            if score < least:
                best, least = turn, score
    return wrapped(best)


@compiled
def flash_cost(
    layout: Layout,
    mean: Array,
    covariance: Array,
    slot: int,
    x: float,
    y: float,
    noise: Array,
    index: Index,
    value: Array,
    first: Array,
    second: Array,
) -> tuple[float, float]:
    """Squared distance of a flash from a wall in standard deviations, and its negative log density."""
    fx, fy = flash_of(layout, mean, slot, index, value)
    xx = projected(covariance, index, value[0], FLASH_ENTRIES, first)
    yy = projected(covariance, index, value[1], FLASH_ENTRIES, second)
    xy = 0.0
    for e in range(FLASH_ENTRIES):
        xy += value[1, e] * first[index[e]]
    a, b, c = xx + noise[0, 0], xy + noise[0, 1], yy + noise[1, 1]
    dx, dy = x - fx, y - fy
    determinant = a * c - b * b
    square = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / determinant
    return square, 0.5 * (square + np.log(determinant)) + np.log(2.0 * np.pi)


@compiled
def _take(
    layout: Layout,
    mean: Array,
    covariance: Array,
    slot: int,
    x: float,
    y: float,
    noise: Array,
    heading_variance: float,
) -> float:
    """Correct a Gaussian, whose last state is the heading, in place by one flash; its log density."""
    n = mean.size - 1
    last = FLASH_ENTRIES
    index, value = np.empty(last + 1, dtype=np.int64), np.empty((2, last + 1))
    fx, fy = flash_of(layout, mean, slot, index[:last], value[:, :last])
    index[last], value[0, last], value[1, last] = n, -fy, fx
    entries = last + 1 if heading_variance > 0.0 else last
    fx, fy = fx - mean[n] * fy, fy + mean[n] * fx
    root = np.sqrt(noise[0, 0])  # Cholesky factor of the noise: whitened coordinates
    low = noise[0, 1] / root
    rest = np.sqrt(noise[1, 1] - low * low)
    white, cross = np.empty((2, entries)), np.empty(n + 1)
    for e in range(entries):
        white[0, e] = value[0, e] / root
        white[1, e] = (value[1, e] - low * value[0, e] / root) / rest
    gap = (x - fx) / root
    other = (y - fy - low * (x - fx) / root) / rest
    log_density = -np.log(root * rest)
    before = np.empty(entries)
    for e in range(entries):
        before[e] = mean[index[e]]
    log_density += scalar_update(mean, covariance, index, white[0], entries, gap, 1.0, cross)
    for e in range(entries):
        other -= white[1, e] * (mean[index[e]] - before[e])
    return float(log_density) + scalar_update(mean, covariance, index, white[1], entries, other, 1.0, cross)


@compiled
def _new_density(
    layout: Layout,
    mean: Array,
    present: NDArray[np.bool_],
    x: float,
    y: float,
    noise: Array,
    model: MatchModel,
) -> float:
    """Density of a flash at (x, y) of a wall not known yet, per square metre.

    Most stand square to known ones.
    """
    reach = max(np.hypot(x, y), 1e-3)
    along = np.arctan2(y, x) - mean[THETA]
    variance = model.square_std_rad**2 + (
        noise[0, 0] * y * y - 2.0 * noise[0, 1] * x * y + noise[1, 1] * x * x
    ) / (reach**4)
    walls, square = 0, 0.0
    first = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    for i in range(layout.slots):
        if present[i]:
            turn = along - np.arctan2(mean[first + 2 * i + 1], mean[first + 2 * i])
            turn -= 0.5 * np.pi * np.round(turn / (0.5 * np.pi))
            square += np.exp(-0.5 * turn * turn / variance)
            walls += 1
    if walls:
        square *= 2.0 * np.pi / (4.0 * walls * np.sqrt(2.0 * np.pi * variance))
    share = model.square_share if walls else 0.0
    return float(0.5 * model.new_density / reach * (1.0 - share + share * square))


@compiled
def double_bounce(
    px: float, py: float, vx: float, vy: float, wx: float, wy: float
) -> tuple[float, float, float]:
    """How a flash over two walls looks from an agent: its range, its middle direction and half its spread.

    There and back over both walls the range is half the way to the agent's image over both; the direction
    lies between those in which the way there begins and the way back ends.
    """
    ax, ay = mirror(px, py, vx, vy)
    ax, ay = mirror(ax, ay, wx, wy)
    bx, by = mirror(px, py, wx, wy)
    bx, by = mirror(bx, by, vx, vy)
    arrival, departure = np.arctan2(ay - py, ax - px), np.arctan2(by - py, bx - px)
    half = 0.5 * wrapped(departure - arrival)
    return 0.5 * np.hypot(ax - px, ay - py), arrival + half, abs(half)


@compiled
def are_double_bounces(
    layout: Layout, mean: Array, present: NDArray[np.bool_], flash: Array, range_m: float, azimuth_rad: float
) -> bool:
    """Whether flashes come over the same two walls ``present``: the agent's places and its images (F, 2, 2).

    Their ranges and directions may be off by ``range_m`` and ``azimuth_rad``.
    """
    first = FIRST_ANCHOR + PER_ANCHOR * layout.anchors
    for i in range(layout.slots):
        for j in range(i):
            if not (present[i] and present[j]):
                continue
            a, b = first + 2 * i, first + 2 * j
            fit = True
            for f in range(flash.shape[0]):
                px, py = flash[f, 0, 0], flash[f, 0, 1]
                dx, dy = flash[f, 1, 0] - px, flash[f, 1, 1] - py
                reach, along = 0.5 * np.hypot(dx, dy), np.arctan2(dy, dx)
                own, middle, half = double_bounce(px, py, mean[a], mean[a + 1], mean[b], mean[b + 1])
                fit &= abs(own - reach) < range_m and abs(wrapped(along - middle)) < half + azimuth_rad
            if fit:
                return True
    return False


@compiled
def _ghost_density(
    layout: Layout,
    mean: Array,
    present: NDArray[np.bool_],
    x: float,
    y: float,
    noise: Array,
    model: MatchModel,
) -> float:
    """Density per square metre of a flash at (x, y) that is a double bounce over two known walls."""
    reach = max(np.hypot(x, y), 1e-3)
    range_m, along = 0.5 * reach - mean[ECHO_BIAS], np.arctan2(y, x) - mean[THETA]
    variance = model.ghost_std_m**2 + 0.25 * (
        noise[0, 0] * x * x + 2.0 * noise[0, 1] * x * y + noise[1, 1] * y * y
    ) / (reach * reach)
    first, pairs, density = FIRST_ANCHOR + PER_ANCHOR * layout.anchors, 0, 0.0
    px, py = mean[0], mean[1]
    for i in range(layout.slots):
        if not present[i]:
            continue
        vx, vy = mean[first + 2 * i], mean[first + 2 * i + 1]
        for j in range(i):
            if not present[j]:
                continue
            pairs += 1
            wx, wy = mean[first + 2 * j], mean[first + 2 * j + 1]
            own, middle, half = double_bounce(px, py, vx, vy, wx, wy)
            gap = own - range_m
            if gap * gap > 16.0 * variance:
                continue
            off, width = abs(wrapped(along - middle)), half + model.ghost_azimuth_rad
            if off < width:
                density += np.exp(-0.5 * gap * gap / variance) / (
                    np.sqrt(2.0 * np.pi * variance) * 2.0 * width
                )
    return float(0.5 * model.ghost_flashes * density / max(pairs, 1) / reach)


@compiled
def match_flashes(
    layout: Layout,
    mean: Array,
    covariance: Array,
    present: NDArray[np.bool_],
    seen: Array,
    noise: Array,
    heading_variance: float,
    model: MatchModel,
    forced: Index,
    slot: Index,
    residual: Array,
) -> tuple[float, float, int, int]:
    """Match flashes with walls, the best pair first, each taken at once; the log density of all.

    What a flash tells of the agent makes the next pair surer. A flash is matched where that is likelier than
    a new wall.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shapes (n + 1,) and (n + 1, n + 1)
        The Gaussian, the unknown heading last; corrected in place.
    present : ndarray of bool, shape (L,)
        Walls that there are.
    seen, noise : ndarray, shapes (J, 2) and (J, 2, 2)
        Flashes and their covariances.
    heading_variance : float
        Of the heading; 0 where it is held.
    model : MatchModel
        Gate, and density of flashes of walls not yet known.
    forced : ndarray of int64, shape (2,)
        A flash, -1 for none, and the wall it must match, -1 for none.
    slot : ndarray of int64, shape (J,)
        Takes the wall of each flash, -1 for a new one, -2 for a double bounce over known ones.
    residual : ndarray, shape (2, 2)
        Takes the squared residuals of the matched flashes over their variances, and what they should be:
        in range, then in direction.

    Returns
    -------
    log_density : float
        Of all flashes.
    margin : float
        By how much the least sure match was likelier than its best alternative, nats.
    flash, wall : int
        That alternative: as ``forced``.
    """
    flashes, slots = seen.shape[0], layout.slots
    index, value = np.empty(FLASH_ENTRIES, dtype=np.int64), np.empty((2, FLASH_ENTRIES))
    first, second = np.empty(mean.size), np.empty(mean.size)
    used = np.zeros(slots, dtype=np.bool_)
    none = np.empty(flashes)
    for j in range(flashes):
        new = _new_density(layout, mean, present, seen[j, 0], seen[j, 1], noise[j], model)
        pair = _ghost_density(layout, mean, present, seen[j, 0], seen[j, 1], noise[j], model)
        none[j], slot[j] = -np.log(new + pair), -1 if new > pair else -2
    total, margin, other_flash, other_wall = 0.0, np.inf, -1, -1
    cost = np.empty((flashes, slots))
    for _ in range(flashes):
        best, flash, wall = np.inf, -1, -1
        for j in range(flashes):
            if slot[j] >= 0:
                continue
            for i in range(slots):
                cost[j, i] = np.inf
                if not present[i] or used[i] or (j == forced[0] and i != forced[1]):
                    continue
                square, own = flash_cost(
                    layout, mean, covariance, i, seen[j, 0], seen[j, 1], noise[j], index, value, first, second
                )
                if square < model.gate_sigma**2:
                    cost[j, i] = own
                    gain = own - none[j] - (1e6 if j == forced[0] else 0.0)
                    if gain < min(best, 0.0):
                        best, flash, wall = gain, j, i
        if flash < 0:
            break
        if flash != forced[0]:
            gap, rival = none[flash] - cost[flash, wall], -1
            for i in range(slots):
                if i != wall and cost[flash, i] - cost[flash, wall] < gap:
                    gap, rival = cost[flash, i] - cost[flash, wall], i
            if gap < margin:
                margin, other_flash, other_wall = gap, flash, rival
        slot[flash] = wall
        used[wall] = True
        total += _take(
            layout, mean, covariance, wall, seen[flash, 0], seen[flash, 1], noise[flash], heading_variance
        )
    residual[:] = 0.0
    along = np.empty(FLASH_ENTRIES)
    for j in range(flashes):
        if slot[j] >= 0:
            fx, fy = flash_of(layout, mean, slot[j], index, value)
            length = max(np.hypot(fx, fy), 1e-3)
            nx, ny = fx / length, fy / length
            for kind in range(2):
                for e in range(FLASH_ENTRIES):
                    along[e] = nx * value[0, e] + ny * value[1, e]
                claimed = nx * nx * noise[j, 0, 0] + 2.0 * nx * ny * noise[j, 0, 1] + ny * ny * noise[j, 1, 1]
                fitted = projected(covariance, index, along, FLASH_ENTRIES, first)
                residual[kind, 0] += (nx * (seen[j, 0] - fx) + ny * (seen[j, 1] - fy)) ** 2 / claimed
                residual[kind, 1] += max(1.0 - fitted / claimed, 0.0)
                nx, ny = -ny, nx
            continue
        new = _new_density(layout, mean, present, seen[j, 0], seen[j, 1], noise[j], model)
        pair = _ghost_density(layout, mean, present, seen[j, 0], seen[j, 1], noise[j], model)
        total += np.log(new + pair)  # where the agent is, the other flashes have told by now
        slot[j] = -1 if new > pair else -2
    return total, margin, other_flash, other_wall
