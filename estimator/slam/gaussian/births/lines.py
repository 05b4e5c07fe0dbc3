"""Lines of length against time among the unassociated paths of an anchor: a wall not yet known shows as one.

A line through a path of the last two epochs is voted for by all other recent paths, each with the interval
of slopes that it allows; by the triangle inequality a path over a wall changes by no more than the agent
moves, which bounds the slopes. Time is that of the latest paths (at most ``most_line_paths``) times the
recent ones; nothing is compared in pairs or triples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.gaussian.births.config import Births
from estimator.slam.models.path_buffer import PathBuffer

__all__ = ["Line", "find_line"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Line:
    """Unassociated paths of one anchor that lie on a line of length against time.

    Parameters
    ----------
    anchor : int
        The anchor.
    row : ndarray of int64, shape (N,)
        Where they stand in the path buffer; epochs ascend, at most one path each.
    epoch : ndarray of int64, shape (N,)
        Their epochs.
    length_m, std_m : ndarray, shape (N,)
        Path lengths and their standard deviations.
    """

    anchor: int
    row: Index
    epoch: Index
    length_m: Array
    std_m: Array


@compiled
def company(time: Array, length: Array, std: Array, place: Array, latest: Index) -> Index:
    """Of each path at ``latest``, how many others it could be one line with, as far as the agent has moved.

    Parameters
    ----------
    time, length, std : ndarray, shape (N,)
        Epochs, path lengths and standard deviations.
    place : ndarray, shape (N, 2)
        Where the agent was.
    latest : ndarray of int64, shape (S,)
        Which paths to ask about.
    """
    count = np.zeros(latest.size, dtype=np.int64)
    for s in range(latest.size):
        b = latest[s]
        for a in range(time.size):
            dx, dy = place[a, 0] - place[b, 0], place[a, 1] - place[b, 1]
            reach = np.sqrt(dx * dx + dy * dy) + 4.0 * np.sqrt(std[a] ** 2 + std[b] ** 2)
            if abs(length[a] - length[b]) < reach:
                count[s] += 1
    return count


@compiled
def slope_votes(
    time: Array, length: Array, std: Array, place: Array, b: int, sigma: float, apart: int
) -> tuple[Array, Array]:
    """Slopes that other paths allow a line through path ``b``: where each interval begins and ends.

    A path ``t`` epochs away votes for the slopes that bring the line within ``sigma`` standard deviations.
    """
    n = time.size
    begin, end, votes = np.empty(n), np.empty(n), 0
    for a in range(n):
        gap = time[b] - time[a]
        if gap < apart:
            continue
        dx, dy = place[a, 0] - place[b, 0], place[a, 1] - place[b, 1]
        reach = np.sqrt(dx * dx + dy * dy) + 4.0 * np.sqrt(std[a] ** 2 + std[b] ** 2)
        if not abs(length[b] - length[a]) < reach:
            continue
        middle, half = (length[b] - length[a]) / gap, sigma * std[a] / gap
        begin[votes], end[votes] = middle - half, middle + half
        votes += 1
    return begin[:votes], end[:votes]


@compiled
def most_overlap(first: Array, last: Array) -> tuple[int, float]:
    """Where most intervals overlap, given their sorted begins and ends, and how many do."""
    votes = first.size
    i = j = inside = most = 0
    at = first[0]
    while i < votes:
        if first[i] <= last[j]:
            inside += 1
            if inside > most:
                most, at = inside, 0.5 * (first[i] + last[j])
            i += 1
        else:
            inside -= 1
            j += 1
    return most, at


@compiled
def crowded(
    buffer: PathBuffer, now: int, limit_db: Array, range_std_m: float, window: int, support: int
) -> bool:
    """Whether some path of the last two epochs has company in enough others: a quick test for most epochs."""
    count, track = buffer.epoch.size, buffer.track
    first = 0
    while first < count and buffer.epoch[first] <= now - window:
        first += 1
    offset = 0
    row = np.empty(count, dtype=np.int64)
    use = np.zeros(count, dtype=np.bool_)
    for n in range(first, count):
        while track.epoch[offset] < buffer.epoch[n]:
            offset += 1
        row[n] = offset
        use[n] = buffer.unassociated[n] and not buffer.excess_loss_db[n] >= limit_db[buffer.anchor[n]]
    for b in range(count - 1, first - 1, -1):
        if buffer.epoch[b] < now - 1:
            break
        if not use[b]:
            continue
        near = 0
        own = max(buffer.std_m[b], range_std_m)
        for a in range(first, count):
            if not use[a] or buffer.anchor[a] != buffer.anchor[b]:
                continue
            dx = track.position_m[row[a], 0] - track.position_m[row[b], 0]
            dy = track.position_m[row[a], 1] - track.position_m[row[b], 1]
            other = max(buffer.std_m[a], range_std_m)
            reach = np.sqrt(dx * dx + dy * dy) + 4.0 * np.sqrt(own * own + other * other)
            if abs(buffer.length_m[a] - buffer.length_m[b]) < reach:
                near += 1
                if near >= support:
                    return True
    return False


def find_line(
    buffer: PathBuffer, now: int, limit_db: Array, range_std_m: float, config: Births
) -> Line | None:
    """The line with most support among recent unassociated paths, or None.

    Parameters
    ----------
    buffer : PathBuffer
        Recent paths and where the agent was.
    now : int
        Present epoch; the line must reach the last two epochs.
    limit_db : ndarray, shape (K,)
        Loss beyond free space of each anchor's paths from which they start no wall
        (:func:`estimator.slam.models.path_loss.loss_limits`).
    range_std_m : float
        Smallest standard deviation of a path length, metres.
    config : Births
        Windows and limits.
    """
    if not crowded(buffer, now, limit_db, range_std_m, config.birth_window, config.birth_support):
        return None
    use = buffer.unassociated & (buffer.epoch > now - config.birth_window)
    rows = np.flatnonzero(use)
    if rows.size < config.birth_support:
        return None
    anchor = buffer.anchor[rows]
    strong = ~(buffer.excess_loss_db[rows] >= limit_db[anchor])  # unknown powers pass
    rows, anchor = rows[strong], anchor[strong]
    best: Line | None = None
    for k in np.flatnonzero(np.bincount(anchor) >= config.birth_support).tolist():
        line = _best_line(buffer, rows[anchor == k], now, range_std_m, config)
        if line is not None and (best is None or len(line.row) > len(best.row)):
            best = line
    return best


def _best_line(buffer: PathBuffer, rows: Index, now: int, range_std_m: float, config: Births) -> Line | None:
    """The line with most support among the paths at ``rows`` of one anchor."""
    latest = np.flatnonzero(buffer.epoch[rows] >= now - 1)
    if latest.size == 0:
        return None
    time, length = buffer.epoch[rows].astype(np.float64), buffer.length_m[rows]
    std = np.maximum(buffer.std_m[rows], range_std_m)
    place = buffer.track.position_m[buffer.row_of(buffer.epoch[rows])]
    near = company(time, length, std, place, latest)
    order = np.argsort(-near, kind="stable")[: config.most_line_paths]
    most, slope, through = 0, 0.0, -1
    for b in latest[order[near[order] >= config.birth_support]].tolist():
        begin, end = slope_votes(time, length, std, place, b, config.line_sigma, config.line_epochs)
        if begin.size == 0:
            continue
        count, at = most_overlap(np.sort(begin), np.sort(end))
        if count > most:
            most, slope, through = count, at, b
    # the path itself, and those too close in time to vote, may lie on the line, too
    if through < 0 or most + config.line_epochs < config.birth_support:
        return None
    width = config.line_sigma * std
    deviation = np.abs(length - (length[through] + slope * (time - time[through])))
    # the motion bends the line: a parabola through the paths near it gathers the rest
    close = deviation < 2.0 * width
    if np.unique(time[close]).size < 3:
        return None
    fit = np.polynomial.Polynomial.fit(time[close], length[close], 2)
    residual = np.abs(length - fit(time))
    ordered = np.lexsort((residual, time))
    first = np.append(True, np.diff(time[ordered]) > 0)
    keep = ordered[first & (residual[ordered] < width[ordered])]
    if len(keep) < config.birth_support or time[keep[-1]] < now - 1:
        return None
    return Line(int(buffer.anchor[rows[0]]), rows[keep], buffer.epoch[rows[keep]], length[keep], std[keep])
