"""Walls with two ends each, how sure these are, and walls assumed where two open ends face each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import segments_cross
from estimator.slam.models.settings import Settings, not_negative, positive
from estimator.twin.ends import Entries, LabelledLines
from estimator.twin.unfolding import line_frames

__all__ = ["ASSUMED", "CORNER", "OPEN", "Closing", "Stretch", "close_gaps", "wall_stretches"]

Array = NDArray[np.float64]
CORNER, OPEN, ASSUMED = "corner", "open", "assumed"
"""Kinds of ends: where another wall is met; where this one stops; where a wall is assumed to go on."""
_REFINE_M = 1.0  # ends in mid-wall are refined within this: four cells
_UNIFORM = 12.0**-0.5  # standard deviation of a uniform law, over its width


@dataclass(frozen=True, eq=False)
class Stretch:
    """A wall.

    Parameters
    ----------
    line : int
        Column of the result's wall; -1 for one that is assumed.
    ends_m : ndarray, shape (2, 2)
        Both ends, estimator's frame, metres.
    kinds : tuple of str
        Kind of each end.
    meets : tuple of int
        The line that each end meets; -1 where none is.
    std_m : tuple of float
        Standard deviation of each end's place (of the larger axis); NaN where it was not observed.
    cuts_m : tuple of float
        Where other walls meet it between its ends, as distances from the first end: what it is made of may
        change there.
    """

    line: int
    ends_m: Array
    kinds: tuple[str, str]
    meets: tuple[int, int]
    std_m: tuple[float, float]
    cuts_m: tuple[float, ...] = ()

    @property
    def length_m(self) -> float:
        """Distance of the ends, metres."""
        return float(np.linalg.norm(self.ends_m[1] - self.ends_m[0]))


@dataclass(frozen=True)
class Closing(Settings):
    """When two open ends are joined by a wall that nobody saw.

    Parameters
    ----------
    longest_m : float
        Ends farther apart are left open.
    parallel_rad : float
        Lines that differ by less in direction count as parallel: the wall between them is at right angles.
    least_support : float
        Where the assumed wall should have been heard, at least this share of it must have been.
    least_expected : int
        Fewer expected reflections say nothing.
    near_m : float
        A measured path within this of an expected reflection supports it.
    doorway_m : float
        An end that faces another stretch of its own line within this is a doorway's, and not closed.
    shortest_m : float
        Stretches shorter than this are dropped: they rest on single paths.
    """

    longest_m: float = positive(30.0)
    parallel_rad: float = positive(0.1)
    least_support: float = positive(0.3)
    least_expected: int = not_negative(4)
    near_m: float = positive(0.15)
    doorway_m: float = positive(4.0)
    shortest_m: float = positive(0.3)


def wall_stretches(
    labelled: LabelledLines, vrps_m: Array, covariance_m2: Array, shortest_m: float = 0.3
) -> list[Stretch]:
    """The stretches of wall of labelled lines.

    Parameters
    ----------
    labelled : LabelledLines
        Cells that are wall.
    vrps_m : ndarray, shape (L, 2)
        The lines.
    covariance_m2 : ndarray, shape (2 L, 2 L)
        Joint covariance of the VRPs.
    shortest_m : float
        Shorter ones are left out.
    """
    found = []
    foot, tangent, _ = line_frames(vrps_m)
    for line, (cells, wall) in enumerate(zip(labelled.cells, labelled.wall, strict=True)):
        entries = labelled.entries.select(labelled.entries.line == line)
        change = np.flatnonzero(np.diff(np.concatenate([[0], wall.astype(np.int64), [0]])))
        for first, last in change.reshape(-1, 2).tolist():
            places, kinds, meets, stds = [], [], [], []
            for bound, sign in ((first, -1), (last, 1)):
                other = int(cells.corner[bound])
                place, std = float(cells.bound_m[bound]), float("nan")
                if other >= 0:
                    std = corner_std(vrps_m, covariance_m2, line, other)
                else:
                    place, std = _free_end(entries, place, sign)
                places.append(place)
                kinds.append(CORNER if other >= 0 else OPEN)
                meets.append(other)
                stds.append(std)
            if places[1] - places[0] >= shortest_m:
                ends = foot[line] + np.array(places)[:, None] * tangent[line]
                cuts = _cuts(labelled, line, first, last, places[0])
                found.append(
                    Stretch(line, ends, (kinds[0], kinds[1]), (meets[0], meets[1]), (stds[0], stds[1]), cuts)
                )
    return found


def _cuts(labelled: LabelledLines, line: int, first: int, last: int, from_m: float) -> tuple[float, ...]:
    """Where other walls meet a stretch of cells between its ends, from its first end on."""
    cells = labelled.cells[line]
    cuts = []
    for bound in range(first + 1, last):
        other = int(cells.corner[bound])
        if other < 0:
            continue
        at = np.flatnonzero(labelled.cells[other].corner == line)
        if any(labelled.wall[other][max(i - 1, 0) : i + 1].any() for i in at):
            cuts.append(float(cells.bound_m[bound]) - from_m)
    return tuple(cuts)


def corner_std(vrps_m: Array, covariance_m2: Array, line: int, other: int) -> float:
    """Standard deviation of the crossing of two lines along the axis in which it is least known, metres."""
    index = [2 * line, 2 * line + 1, 2 * other, 2 * other + 1]
    values = np.concatenate([vrps_m[line], vrps_m[other]])
    jacobian = np.empty((2, 4))
    for i in range(4):
        step = np.zeros(4, dtype=np.complex128)
        step[i] = 1e-20j
        jacobian[:, i] = _crossing(values + step).imag / 1e-20
    spread = jacobian @ covariance_m2[np.ix_(index, index)] @ jacobian.T
    return float(np.sqrt(max(np.linalg.eigvalsh(spread)[-1], 0.0)))


def _crossing(pair: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """The point x with x . v = |v|^2 / 2 for both VRPs v."""
    a, b, c, d = pair
    first, second = 0.5 * (a * a + b * b), 0.5 * (c * c + d * d)
    determinant = a * d - b * c
    return np.asarray(np.array([d * first - b * second, a * second - c * first]) / determinant)


def _free_end(entries: Entries, place_m: float, sign: int) -> tuple[float, float]:
    """Where an end in mid-wall agrees best with what was asked nearby, and its standard deviation.

    ``sign`` is 1 for an end beyond which the coordinate grows. Anywhere between two places of evidence is
    as good.
    """
    near = np.abs(entries.place_m - place_m) < _REFINE_M
    place, wants, price = entries.place_m[near], entries.wants_wall[near], entries.price[near]
    if not place.size:
        return place_m, float("nan")
    order = np.argsort(sign * place)
    along, wants, price = sign * place[order], wants[order], price[order]
    before = np.concatenate([[0.0], np.cumsum(np.where(wants, 0.0, price))])  # openings inside the wall
    after = np.concatenate([np.cumsum(np.where(wants, price, 0.0)[::-1])[::-1], [0.0]])  # bounces outside
    best = int(np.argmin(before + after))
    edges = np.concatenate([[sign * place_m - _REFINE_M], along, [sign * place_m + _REFINE_M]])
    low, high = float(edges[best]), float(edges[best + 1])
    if best == 0 or best == len(along):  # nothing on one side: the end is where the evidence is
        return sign * (high if best == 0 else low), float("nan")
    return sign * 0.5 * (low + high), _UNIFORM * (high - low)


def close_gaps(
    stretches: list[Stretch], heard_m: Array, config: Closing | None = None
) -> tuple[list[Stretch], list[Stretch]]:
    """Walls that join open ends that face each other, and the stretches with these ends changed.

    Lines that meet beyond both ends go on to their corner. Of parallel lines the wall between is at right
    angles, from the end that is known better; else it is straight. It must not be crossed by anything heard.

    Parameters
    ----------
    stretches : list of Stretch
        The walls.
    heard_m : ndarray, shape (N, 2, 2)
        Legs of heard paths.
    config : Closing, optional
        When gaps are closed.

    Returns
    -------
    stretches, assumed : list of Stretch
    """
    config = config or Closing()
    ends = [
        (i, e)
        for i, s in enumerate(stretches)
        for e in (0, 1)
        if s.kinds[e] == OPEN and not _at_doorway(stretches, i, e, config.doorway_m)
    ]
    changed, assumed = list(stretches), []
    pairs = []
    for n, (i, e) in enumerate(ends):
        for j, g in ends[n + 1 :]:
            if stretches[i].line != stretches[j].line:  # a gap in a line is an opening
                gap = float(np.linalg.norm(stretches[i].ends_m[e] - stretches[j].ends_m[g]))
                if gap <= config.longest_m:
                    pairs.append((gap, i, e, j, g))
    taken: set[tuple[int, int]] = set()
    for _, i, e, j, g in sorted(pairs):
        if (i, e) in taken or (j, g) in taken:
            continue
        if not _better_known(stretches[i].std_m[e], stretches[j].std_m[g]):
            i, e, j, g = j, g, i, e
        meet = _corner(stretches[i], e, stretches[j], g, config)
        if meet is not None:
            if not any(_crossed(stretches[a].ends_m[b], meet, heard_m) for a, b in ((i, e), (j, g))):
                changed[i] = _with_end(changed[i], e, meet, float("nan"))
                changed[j] = _with_end(changed[j], g, meet, float("nan"))
                taken |= {(i, e), (j, g)}
            continue
        start = stretches[i].ends_m[e]
        finish = _opposite(stretches[i], e, stretches[j], g, config.parallel_rad)
        if np.linalg.norm(finish - start) < config.shortest_m:
            continue
        if _folds_back(stretches[i], e, finish - start) or _folds_back(stretches[j], g, start - finish):
            continue
        if _crossed(start, finish, heard_m) or _crossed(stretches[j].ends_m[g], finish, heard_m):
            continue
        std = stretches[i].std_m[e]
        assumed.append(Stretch(-1, np.array([start, finish]), (ASSUMED, ASSUMED), (-1, -1), (std, std)))
        changed[i] = _with_end(changed[i], e, start, std)
        changed[j] = _with_end(changed[j], g, finish, std)
        taken |= {(i, e), (j, g)}
    return changed, assumed


def _folds_back(stretch: Stretch, end: int, along: Array) -> bool:
    """Whether a wall that leads on from an end runs back beside the stretch."""
    outward = stretch.ends_m[end] - stretch.ends_m[1 - end]
    return float(outward @ along) < -0.5 * float(np.linalg.norm(outward) * np.linalg.norm(along))


def _at_doorway(stretches: list[Stretch], i: int, e: int, doorway_m: float) -> bool:
    """Whether the end ``e`` of a stretch faces another stretch of its line nearby."""
    here = stretches[i].ends_m[e]
    others = [s.ends_m for j, s in enumerate(stretches) if j != i and s.line == stretches[i].line]
    return any(bool(np.linalg.norm(ends - here, axis=1).min() < doorway_m) for ends in others)


def _better_known(one: float, other: float) -> bool:
    return not np.isnan(one) and (np.isnan(other) or one <= other)


def _corner(one: Stretch, e: int, other: Stretch, g: int, config: Closing) -> Array | None:
    """Where two lines meet beyond the ends of two stretches; None if they do not, or too far away."""
    reach = []
    for stretch, end in ((one, e), (other, g)):
        outward = stretch.ends_m[end] - stretch.ends_m[1 - end]
        reach.append((stretch.ends_m[end], outward / np.linalg.norm(outward)))
    (p, u), (q, v) = reach
    sine = float(u[0] * v[1] - u[1] * v[0])
    if abs(sine) < np.sin(config.parallel_rad):
        return None
    gap = q - p
    along = float(gap[0] * v[1] - gap[1] * v[0]) / sine, float(gap[0] * u[1] - gap[1] * u[0]) / sine
    if min(along) < -config.near_m or max(along) > config.longest_m:
        return None
    return np.asarray(p + along[0] * u)


def _opposite(near: Stretch, e: int, far: Stretch, g: int, parallel_rad: float) -> Array:
    """Where a wall from the end ``e`` of one stretch meets another's line, at or near its end ``g``."""
    along = (far.ends_m[1] - far.ends_m[0]) / far.length_m
    own = (near.ends_m[1] - near.ends_m[0]) / near.length_m
    sine = abs(float(along[0] * own[1] - along[1] * own[0]))
    start, end = near.ends_m[e], far.ends_m[g]
    if sine > np.sin(parallel_rad):
        return np.asarray(end)
    foot = far.ends_m[0] + float((start - far.ends_m[0]) @ along) * along
    outward = along if g == 1 else -along
    if float((foot - end) @ outward) < -0.5:  # it would cut off wall that was seen
        return np.asarray(end)
    return np.asarray(foot)


def _crossed(start: Array, finish: Array, legs_m: Array) -> bool:
    """Whether more than one leg in a thousand crosses a segment: a few paths are mistaken."""
    if not len(legs_m) or np.allclose(start, finish):
        return False
    crossed = segments_cross(legs_m[:, 0], legs_m[:, 1], start, finish)
    return bool(crossed.sum() > 1e-3 * len(legs_m))


def _with_end(stretch: Stretch, end: int, place: Array, std: float) -> Stretch:
    ends, kinds, stds = stretch.ends_m.copy(), list(stretch.kinds), list(stretch.std_m)
    ends[end], kinds[end], stds[end] = place, ASSUMED, std
    return replace(stretch, ends_m=ends, kinds=(kinds[0], kinds[1]), std_m=(stds[0], stds[1]))
