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
def may_be_one_line(
    length: float, std: float, place: Array, other_length: float, other_std: float, other_place: Array
) -> bool:
    """Whether two paths differ by no more than the agent moved between their places (2,) and errors."""
    dx, dy = place[0] - other_place[0], place[1] - other_place[1]
    reach = np.sqrt(dx * dx + dy * dy) + 4.0 * np.sqrt(std * std + other_std * other_std)
    return bool(abs(length - other_length) < reach)


@compiled
def recent_paths(buffer: PathBuffer, now: int, window: int, limit_db: Array) -> tuple[Index, Index]:
    """Rows (N,) of the paths that may make a line, and the rows of the track that they were heard at."""
    track, offset, found = buffer.track, 0, 0
    row, place = np.empty(buffer.epoch.size, dtype=np.int64), np.empty(buffer.epoch.size, dtype=np.int64)
    for n in range(buffer.epoch.size):
        strong = not buffer.excess_loss_db[n] >= limit_db[buffer.anchor[n]]  # unknown powers pass
        if buffer.epoch[n] <= now - window or not buffer.unassociated[n] or not strong:
            continue
        while track.epoch[offset] < buffer.epoch[n]:
            offset += 1
        row[found], place[found] = n, offset
        found += 1
    return row[:found], place[:found]


@compiled
def company(buffer: PathBuffer, row: Index, place: Index, now: int, range_std_m: float) -> Index:
    """Of each path (N,) of the last two epochs, how many of its anchor it may be one line with; else 0.

    Parameters
    ----------
    buffer : PathBuffer
        Recent paths and where the agent was.
    row, place : ndarray of int64, shape (N,)
        The paths, and where the agent was (:func:`recent_paths`).
    now : int
        Present epoch.
    range_std_m : float
        Smallest standard deviation of a path length, metres.
    """
    count, track = np.zeros(row.size, dtype=np.int64), buffer.track
    for b in range(row.size - 1, -1, -1):
        if buffer.epoch[row[b]] < now - 1:
            break
        for a in range(row.size):
            if buffer.anchor[row[a]] == buffer.anchor[row[b]] and may_be_one_line(
                buffer.length_m[row[b]],
                max(buffer.std_m[row[b]], range_std_m),
                track.position_m[place[b]],
                buffer.length_m[row[a]],
                max(buffer.std_m[row[a]], range_std_m),
                track.position_m[place[a]],
            ):
                count[b] += 1
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
        if not may_be_one_line(length[a], std[a], place[a], length[b], std[b], place[b]):
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
    rows, place = recent_paths(buffer, now, config.birth_window, limit_db)
    near = company(buffer, rows, place, now, range_std_m)
    best: Line | None = None
    anchor = buffer.anchor[rows]
    for k in np.unique(anchor[near >= config.birth_support]).tolist():
        mine = anchor == k
        line = _best_line(buffer, rows[mine], place[mine], near[mine], now, range_std_m, config)
        if line is not None and (best is None or len(line.row) > len(best.row)):
            best = line
    return best


def _best_line(
    buffer: PathBuffer, rows: Index, places: Index, near: Index, now: int, range_std_m: float, config: Births
) -> Line | None:
    """The line with most support among one anchor's paths at ``rows``, which have ``near`` others each."""
    time, length = buffer.epoch[rows].astype(np.float64), buffer.length_m[rows]
    std = np.maximum(buffer.std_m[rows], range_std_m)
    place = buffer.track.position_m[places]
    order = np.argsort(-near, kind="stable")[: config.most_line_paths]
    most, slope, through = 0, 0.0, -1
    for b in order[near[order] >= config.birth_support].tolist():
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
