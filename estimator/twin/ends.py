"""Where walls end: stretches of lines that agree best with what was heard and what was not.

Extents of reflections alone miss the ends of walls by tens of metres, and a few wrong double bounces move
them as far. So every line is cut into cells that are wall or open, and contradictions are weighed: a
heard bounce in the open, a heard leg through a wall, a silent path that nothing explains; double bounces
count
while nothing else speaks against them. Changes between
wall and open cost less where another wall is met there (a corner) than in mid-wall. For one line, given the
others, the
cheapest labelling is exact (Viterbi); lines are visited in turn until nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.settings import Settings, positive
from estimator.twin.sightings import Sightings
from estimator.twin.unfolding import crossing_points, line_frames

__all__ = ["EndSearch", "Entries", "LabelledLines", "LineCells", "label_lines", "line_cells"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class EndSearch(Settings):
    """Prices of contradictions and changes, in nats, and how lines are cut.

    Parameters
    ----------
    heard_single, heard_double : float
        A heard path that an end contradicts: line of sight and single bounces are hardly ever taken for
        another path, double bounces sometimes.
    silent, silent_run : float
        A silent path that nothing explains, and successive ones of one feature together at most: they
        may have another cause.
    corner, free_end : float
        A change between wall and open where another wall is met, and elsewhere.
    flash : float
        A wall that a sweep saw at right angles, contradicted: hardly ever anything else.
    walked : float
        A place where the agent walked through a wall: it did not.
    clearance_m : float
        Half the width that it needs.
    open_per_m : float
        A metre of wall of which nothing is known: walls reach to the nearest corner, not to the farthest.
    cell_m : float
        Length of cells: ends are refined within them.
    margin_m : float
        Lines are looked at this far beyond everything that was heard.
    rounds : int
        Times that all lines are visited, at most.
    """

    heard_single: float = positive(1.5)
    heard_double: float = positive(0.5)
    silent: float = positive(0.3)
    silent_run: float = positive(4.0)
    corner: float = positive(1.0)
    free_end: float = positive(5.0)
    flash: float = positive(1.5)
    walked: float = positive(20.0)
    clearance_m: float = positive(0.2)
    open_per_m: float = positive(0.03)
    cell_m: float = positive(0.25)
    margin_m: float = positive(8.0)
    rounds: int = positive(8)


@dataclass(frozen=True, eq=False)
class LineCells:
    """One line, cut.

    Parameters
    ----------
    bound_m : ndarray, shape (C + 1,)
        Bounds of the cells, coordinates along the line.
    corner : ndarray of int64, shape (C + 1,)
        The line that is met at each bound; -1 where none is.
    """

    bound_m: Array
    corner: Index


@dataclass(frozen=True, eq=False)
class Entries:
    """What paths ask of lines: one row for each bounce and each crossing.

    Parameters
    ----------
    path, line : ndarray of int64, shape (N,)
        Number of the path, and the line.
    place_m : ndarray, shape (N,)
        Where on the line.
    wants_wall : ndarray of bool, shape (N,)
        Whether the path needs wall there, or an opening.
    price : ndarray, shape (N,)
        What a contradiction costs, nats.
    """

    path: Index
    line: Index
    place_m: Array
    wants_wall: Mask
    price: Array

    def select(self, mask: Mask) -> Entries:
        """The rows of a mask (N,)."""
        return Entries(*(getattr(self, entry.name)[mask] for entry in fields(Entries)))

    def joined(self, other: Entries) -> Entries:
        """These and others; paths are no longer numbered apart."""
        return Entries(
            *(np.concatenate([getattr(self, e.name), getattr(other, e.name)]) for e in fields(Entries))
        )


@dataclass(frozen=True, eq=False)
class LabelledLines:
    """Lines cut into wall and open.

    Parameters
    ----------
    cells : tuple of LineCells
        Every line, cut.
    wall : tuple of ndarray of bool
        Whether each cell is wall.
    entries : Entries
        What was asked of them in the end.
    """

    cells: tuple[LineCells, ...]
    wall: tuple[Mask, ...]
    entries: Entries


def line_cells(sights: Sightings, vrps_m: Array, config: EndSearch) -> list[LineCells]:
    """Cut every line within reach of what was heard."""
    paths = sights.unfolded
    meets = crossing_points(vrps_m)
    known = paths.vertex_m[sights.heard]
    if not len(known):
        known = paths.vertex_m[:, :, :1].reshape(-1, 4, 2)
    low = known.reshape(-1, 2).min(axis=0) - config.margin_m
    high = known.reshape(-1, 2).max(axis=0) + config.margin_m
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    cells = []
    for line, vrp in enumerate(vrps_m):
        tangent = np.array([-vrp[1], vrp[0]]) / np.linalg.norm(vrp)
        reach = (corners - 0.5 * vrp) @ tangent
        first, last = float(reach.min()), float(reach.max())
        others = np.flatnonzero((meets[line] > first) & (meets[line] < last))
        order = others[np.argsort(meets[line][others])]
        bounds, met = [first], [-1]
        for place, other in [*zip(meets[line][order].tolist(), order.tolist(), strict=True), (last, -1)]:
            count = max(1, int(np.ceil((place - bounds[-1]) / config.cell_m)))
            bounds += np.linspace(bounds[-1], place, count + 1)[1:].tolist()
            met += [-1] * (count - 1) + [other]
        cells.append(LineCells(np.array(bounds), np.array(met, dtype=np.int64)))
    return cells


def label_lines(sights: Sightings, vrps_m: Array, config: EndSearch | None = None) -> LabelledLines:
    """Which cells of every line are wall.

    Parameters
    ----------
    sights : Sightings
        What was heard.
    vrps_m : ndarray, shape (L, 2)
        Walls.
    config : EndSearch, optional
        Prices.

    Returns
    -------
    LabelledLines
    """
    config = config or EndSearch()
    cells = line_cells(sights, vrps_m, config)
    double, prices = np.sum(sights.unfolded.walls >= 0, axis=1) > 1, _prices(sights, config)
    heard = _entries(sights, sights.heard & ~double, prices).joined(_walked(sights, vrps_m, config))
    heard = heard.joined(_flashed(sights, vrps_m, config))
    silent = _entries(sights, sights.silent, _silence_prices(sights.silent, config))
    doubtful = _entries(sights, sights.heard & double, prices)
    labels = [
        _cheapest(_unary(heard, line, cells[line]), cells[line], _changes(line, cells, None, config), config)
        for line in range(len(cells))
    ]
    for _ in range(config.rounds):
        before = [label.copy() for label in labels]
        for line in range(len(cells)):
            asked = [heard, _undisputed(doubtful, cells, labels), _open_questions(silent, cells, labels)]
            unary = np.sum([_unary(entries, line, cells[line]) for entries in asked], axis=0)
            labels[line] = _cheapest(unary, cells[line], _changes(line, cells, labels, config), config)
        if all(np.array_equal(a, b) for a, b in zip(before, labels, strict=True)):
            break
    entries = heard.joined(_undisputed(doubtful, cells, labels)).joined(
        _open_questions(silent, cells, labels)
    )
    return LabelledLines(tuple(cells), tuple(labels), entries)


def _prices(sights: Sightings, config: EndSearch) -> Array:
    """What contradicting each path (T, K, F) costs, if it was heard."""
    double = np.sum(sights.unfolded.walls >= 0, axis=1) > 1
    return np.where(double, config.heard_double, config.heard_single) * sights.weight


def _silence_prices(silent: Mask, config: EndSearch) -> Array:
    """What silent paths (T, K, F) cost, successive ones of a feature less."""
    price = np.full(silent.shape, config.silent)
    begins = np.diff(silent.astype(np.int8), axis=0, prepend=0) == 1
    run = np.cumsum(begins, axis=0)
    for k, f in zip(*np.nonzero(silent.any(axis=0)), strict=True):
        mine = silent[:, k, f]
        length = np.bincount(run[mine, k, f])
        price[mine, k, f] *= np.minimum(1.0, config.silent_run / (config.silent * length[run[mine, k, f]]))
    return price


def _entries(sights: Sightings, which: Mask, price: Array) -> Entries:
    """The bounces and crossings of some paths."""
    paths = sights.unfolded
    t, k, f = np.nonzero(which)
    number = np.arange(len(t))
    bounce, crossing = paths.bounce_m[t, k, f], paths.crossing_m[t, k, f]
    on, off = np.nonzero(np.isfinite(bounce)), np.nonzero(np.isfinite(crossing))
    own = price[t, k, f]
    return Entries(
        np.concatenate([number[on[0]], number[off[0]]]),
        np.concatenate([paths.walls[f[on[0]], on[1]], off[2]]),
        np.concatenate([bounce[on], crossing[off]]),
        np.concatenate([np.ones(len(on[0]), dtype=bool), np.zeros(len(off[0]), dtype=bool)]),
        np.concatenate([own[on[0]], own[off[0]]]),
    )


def _walked(sights: Sightings, vrps_m: Array, config: EndSearch) -> Entries:
    """Openings that the agent's track needs."""
    track = sights.unfolded.vertex_m[:, 0, 0, -1]
    foot, tangent, normal = line_frames(vrps_m)
    side = track @ normal.T - np.sum(foot * normal, axis=1)
    along = track @ tangent.T - np.sum(foot * tangent, axis=1)
    step, line = np.nonzero(side[:-1] * side[1:] < 0.0)
    before, after = side[step, line], side[step + 1, line]
    place = along[step, line] + before / (before - after) * (along[step + 1, line] - along[step, line])
    width = config.clearance_m * np.array([-1.0, 0.0, 1.0])
    places = (place[:, None] + width).ravel()
    return Entries(
        np.full(len(places), -1),
        np.repeat(line, len(width)),
        places,
        np.zeros(len(places), dtype=bool),
        np.full(len(places), config.walked),
    )


def _flashed(sights: Sightings, vrps_m: Array, config: EndSearch) -> Entries:
    """What sweeps ask for: wall at the foot of the perpendicular, and nothing before it."""
    foot, tangent, normal = line_frames(vrps_m)
    agent, wall = sights.unfolded.vertex_m[sights.flash_row, 0, 0, -1], sights.flash_wall
    own = np.sum((agent - foot[wall]) * tangent[wall], axis=1)
    point = foot[wall] + own[:, None] * tangent[wall]
    start = agent @ normal.T - np.sum(foot * normal, axis=1)
    end = point @ normal.T - np.sum(foot * normal, axis=1)
    crossed = (start * end < 0.0) & (np.arange(len(foot)) != wall[:, None])
    number, line = np.nonzero(crossed)
    share = start[number, line] / (start[number, line] - end[number, line])
    place = agent[number] + share[:, None] * (point[number] - agent[number])
    off = np.sum((place - foot[line]) * tangent[line], axis=1)
    count = len(wall) + len(line)
    return Entries(
        np.full(count, -1),
        np.concatenate([wall, line]),
        np.concatenate([own, off]),
        np.arange(count) < len(wall),
        np.full(count, config.flash),
    )


def _cell_of(cells: LineCells, place_m: Array) -> Index:
    """Cells of places; those beyond the ends count as the last."""
    found = np.searchsorted(cells.bound_m, place_m, side="right") - 1
    return np.clip(found, 0, len(cells.bound_m) - 2)


def _unary(entries: Entries, line: int, cells: LineCells) -> Array:
    """What each cell of a line costs as open and as wall, shape (C, 2)."""
    mine = entries.select(entries.line == line)
    cell = _cell_of(cells, mine.place_m)
    count = len(cells.bound_m) - 1
    cost = np.zeros((count, 2))
    for label, wants in ((0, mine.wants_wall), (1, ~mine.wants_wall)):
        cost[:, label] = np.bincount(cell[wants], mine.price[wants], minlength=count)
    return cost


def _open_questions(silent: Entries, cells: list[LineCells], labels: list[Mask]) -> Entries:
    """Entries of silent paths that could still explain the silence, asking for the opposite.

    A silent path needs one contradiction. Where nothing else contradicts it, its bounce had better be in the
    open, or what it crosses be wall.
    """
    asked = silent.select(_uncontradicted_elsewhere(silent, cells, labels))
    return Entries(asked.path, asked.line, asked.place_m, ~asked.wants_wall, asked.price)


def _undisputed(heard: Entries, cells: list[LineCells], labels: list[Mask]) -> Entries:
    """Entries of heard paths that nothing else contradicts: else another wall is the likelier cause."""
    return heard.select(_uncontradicted_elsewhere(heard, cells, labels))


def _uncontradicted_elsewhere(entries: Entries, cells: list[LineCells], labels: list[Mask]) -> Mask:
    """Which entries (N,) belong to paths that no other entry contradicts."""
    if not len(entries.path):
        return np.zeros(0, dtype=bool)
    wall = np.zeros(len(entries.path), dtype=bool)
    for line, label in enumerate(labels):
        mine = entries.line == line
        wall[mine] = label[_cell_of(cells[line], entries.place_m[mine])]
    contradicted = wall != entries.wants_wall
    total = np.bincount(entries.path, contradicted)
    return np.asarray(total[entries.path] - contradicted == 0)


def _changes(line: int, cells: list[LineCells], labels: list[Mask] | None, config: EndSearch) -> Array:
    """What a change at each inner bound of a line costs, (C - 1,); at first every crossing is a corner."""
    corner = cells[line].corner[1:-1]
    cost = np.full(len(corner), config.free_end)
    for place in np.flatnonzero(corner >= 0):
        other = int(corner[place])
        at = np.flatnonzero(cells[other].corner == line)
        if labels is None or any(labels[other][max(i - 1, 0) : i + 1].any() for i in at):
            cost[place] = config.corner
    return cost


def _cheapest(unary: Array, cells: LineCells, changes: Array, config: EndSearch) -> Mask:
    """The cheapest labels of a line's cells: Viterbi's algorithm."""
    size = np.diff(cells.bound_m)
    cost = unary.copy()
    cost[:, 1] += config.open_per_m * size
    cost[[0, -1], 1] += config.free_end  # beyond what was looked at there is no wall
    count = len(cost)
    best, came = cost[0].copy(), np.zeros((count, 2), dtype=np.int64)
    for i in range(1, count):
        step = np.array([[0.0, changes[i - 1]], [changes[i - 1], 0.0]])
        total = best[:, None] + step
        came[i] = total.argmin(axis=0)
        best = total.min(axis=0) + cost[i]
    label = np.empty(count, dtype=bool)
    state = int(best.argmin())
    for i in range(count - 1, -1, -1):
        label[i] = bool(state)
        state = int(came[i, state])
    return label
