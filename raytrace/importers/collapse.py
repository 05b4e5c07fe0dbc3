"""Walls drawn by their two faces become one surface, with the thickness that was drawn.

Lines are sorted into families of one direction; within a family a line is an offset
across and an interval along, and everything is arithmetic of intervals:

1. lines of one offset and material that touch or overlap are merged;
2. two lines of one material, nearer than the thickest wall and side by side over at
   least twice their distance, are the faces of a wall: what they share becomes its
   centre line (so a square column stays four surfaces), the widest pairs first, so that
   what is drawn between two faces (the panes of a window) goes with them;
3. rests of faces no longer than the thickest wall lay behind a junction and vanish,
   longer ones stay as single lines; a centre line goes on where one face goes on;
4. short lines across the end of a centre line (caps, jambs) vanish;
5. where lines of two materials lie on one another (a window on a wall, a border of two rooms), the
   shorter stays and the longer is cut: no beam tells two surfaces at one place apart.

Ends still stop at the faces of the walls they run into; :mod:`raytrace.importers.joins` mends that.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from raytrace.importers.drawing import ImportReport, Line

__all__ = ["collapse"]

Array = NDArray[np.float64]
Interval = tuple[float, float]

_SAME_ANGLE_RAD = np.deg2rad(0.2)
_SAME_PLACE_M = 2e-3
_SHORTEST_M = 0.02
_THINNEST_M = 0.01


@dataclass(eq=False)
class _Run:
    """A line within its family: offset across, interval along, and what of it is still single."""

    offset: float
    span: Interval
    line: Line
    rest: list[Interval] = field(default_factory=list)
    paired: bool = False

    def __post_init__(self) -> None:
        self.rest = [self.span]


def collapse(lines: list[Line], thickest_m: float, report: ImportReport) -> list[Line]:
    """Collapse double lines to single surfaces.

    Parameters
    ----------
    lines : list of Line
        As drawn.
    thickest_m : float
        Lines nearer than this can be faces of one wall, metres.
    report : ImportReport
        Told what was collapsed and dropped.

    Returns
    -------
    list of Line
        Lines that were neither merged nor paired are returned as they came.
    """
    long = [line for line in lines if line.length_m >= _SHORTEST_M]
    if len(long) < len(lines):
        report.dropped[f"line shorter than {_SHORTEST_M * 100:g} cm"] += len(lines) - len(long)
    centres: list[Line] = []
    singles: list[Line] = []
    for direction, members in _families(long):
        runs = _merged(direction, members, report)
        found = _pairs(runs, thickest_m, direction)
        report.collapsed["pair of lines to one surface"] += len(found)
        joined = _continued(found, runs, thickest_m)
        centres += [_line(direction, offset, span, like) for offset, span, like in joined]
        for run in runs:
            if not run.paired:
                singles.append(run.line)
                continue
            singles += [
                _line(direction, run.offset, span, run.line)
                for span in run.rest
                if span[1] - span[0] > thickest_m
            ]
    caps = _are_caps(singles, centres)
    kept = [line for line, cap in zip(singles, caps, strict=True) if not cap]
    if len(kept) < len(singles):
        report.collapsed["end of a wall, with its faces"] += len(singles) - len(kept)
    left = _without_overlaps(centres + kept, report)
    report.collapsed = +report.collapsed
    return left


def _families(lines: list[Line]) -> Iterable[tuple[Array, list[Line]]]:
    """Lines sorted by direction: a unit vector, and the lines along it."""
    if not lines:
        return
    vectors = np.array([np.subtract(line.end_m, line.start_m) for line in lines])
    angle = np.mod(np.arctan2(vectors[:, 1], vectors[:, 0]), np.pi)
    angle[angle > np.pi - _SAME_ANGLE_RAD] -= np.pi
    order = np.argsort(angle, kind="stable")
    breaks = np.flatnonzero(np.diff(angle[order]) > _SAME_ANGLE_RAD) + 1
    for group in np.split(order, breaks):
        longest = group[np.argmax(np.linalg.norm(vectors[group], axis=1))]
        direction = np.array([np.cos(angle[longest]), np.sin(angle[longest])])
        yield np.round(direction, 15), [lines[index] for index in group]


def _merged(direction: Array, lines: list[Line], report: ImportReport) -> list[_Run]:
    """Runs of a family, one for all lines of one offset and material that touch."""
    normal = np.array([-direction[1], direction[0]])
    runs = []
    for line in lines:
        ends = np.array([line.start_m, line.end_m])
        along = np.sort(ends @ direction)
        runs.append(_Run(float((ends @ normal).mean()), (float(along[0]), float(along[1])), line))
    runs.sort(key=lambda run: (run.line.material, round(run.offset / _SAME_PLACE_M), run.span))
    merged: list[_Run] = []
    for run in runs:
        last = merged[-1] if merged else None
        if (
            last is not None
            and last.line.material == run.line.material
            and abs(last.offset - run.offset) <= _SAME_PLACE_M
            and run.span[0] <= last.span[1] + _SAME_PLACE_M
        ):
            report.collapsed["line continued or drawn twice"] += 1
            span = (last.span[0], max(last.span[1], run.span[1]))
            like = replace(last.line, height_m=max(last.line.height_m, run.line.height_m))
            merged[-1] = _Run(last.offset, span, _line(direction, last.offset, span, like))
        else:
            merged.append(run)
    return sorted(merged, key=lambda run: run.offset)


def _pairs(runs: list[_Run], thickest_m: float, direction: Array) -> list[tuple[float, Interval, Line]]:
    """Centre lines of pairs of faces: offset, span, and a line like them."""
    candidates = []
    for first, one in enumerate(runs):
        for other in runs[first + 1 :]:
            gap = other.offset - one.offset
            if gap > thickest_m:
                break
            if gap >= _THINNEST_M and one.line.material == other.line.material:
                candidates.append((gap, one, other))
    candidates.sort(key=lambda candidate: -candidate[0])
    offsets = [run.offset for run in runs]
    found = []
    for gap, one, other in candidates:
        for shared in _common(one.rest, other.rest):
            if shared[1] - shared[0] < 2.0 * gap:
                continue
            between = slice(bisect_left(offsets, one.offset), bisect_right(offsets, other.offset))
            for run in runs[between]:  # the two faces, and what is drawn between them
                if run.line.material == one.line.material:
                    left = _without(run.rest, shared)
                    run.paired = run.paired or left != run.rest
                    run.rest = left
            height = max(one.line.height_m, other.line.height_m)
            like = replace(one.line, thickness_m=round(gap, 4), drawn_m=gap, height_m=height)
            found.append((0.5 * (one.offset + other.offset), shared, like))
    return found


def _common(one: list[Interval], other: list[Interval]) -> list[Interval]:
    """What two lists of intervals share."""
    both = [(max(a[0], b[0]), min(a[1], b[1])) for a in one for b in other]
    return [span for span in both if span[1] > span[0]]


def _without(spans: list[Interval], taken: Interval) -> list[Interval]:
    """Intervals less one."""
    left = []
    for low, high in spans:
        if taken[1] <= low or taken[0] >= high:
            left.append((low, high))
            continue
        left += [part for part in ((low, taken[0]), (taken[1], high)) if part[1] - part[0] > 1e-9]
    return left


def _continued(
    found: list[tuple[float, Interval, Line]], runs: list[_Run], thickest_m: float
) -> list[tuple[float, Interval, Line]]:
    """Centre lines joined over junctions: gaps that one of the faces passes without a break."""
    joined: list[tuple[float, Interval, Line]] = []
    offsets = [run.offset for run in runs]
    for offset, span, like in sorted(
        found, key=lambda item: (item[2].material, round(item[0] / _SAME_PLACE_M), item[1])
    ):
        if joined:
            before, last, former = joined[-1]
            gap = (last[1], span[0])
            if (
                former.material == like.material
                and abs(before - offset) < _SAME_PLACE_M
                and abs(former.drawn_m - like.drawn_m) < _SAME_PLACE_M
                and gap[1] - gap[0] <= thickest_m
                and any(_passes(runs, offsets, offset + 0.5 * side * like.drawn_m, gap) for side in (-1, 1))
            ):
                joined[-1] = (before, (last[0], max(last[1], span[1])), former)
                continue
        joined.append((offset, span, like))
    return joined


def _passes(runs: list[_Run], offsets: list[float], offset: float, gap: Interval) -> bool:
    """Whether one of the runs, sorted by ``offsets``, has an offset and passes a gap without a break."""
    low, high = bisect_right(offsets, offset - _SAME_PLACE_M), bisect_left(offsets, offset + _SAME_PLACE_M)
    return any(run.span[0] <= gap[0] + 1e-9 and run.span[1] >= gap[1] - 1e-9 for run in runs[low:high])


def _without_overlaps(lines: list[Line], report: ImportReport) -> list[Line]:
    """Lines of one family and offset cut so that none lies on another; the shorter stays, then the former."""
    pieces = {id(line): [line] for line in lines}
    for direction, members in _families(lines):
        runs: dict[int, list[_Run]] = {}  # by offset, so that only neighbours are compared
        for line in sorted(members, key=lambda line: round(line.length_m, 6)):
            ends = np.array([line.start_m, line.end_m])
            along = np.sort(ends @ direction)
            offset = float((ends @ np.array([-direction[1], direction[0]])).mean())
            run = _Run(offset, (float(along[0]), float(along[1])), line)
            place = round(offset / _SAME_PLACE_M)
            for other in (near for beside in (-1, 0, 1) for near in runs.get(place + beside, ())):
                if abs(other.offset - offset) <= _SAME_PLACE_M:
                    run.rest = _without(run.rest, other.span)
            if sum(high - low for low, high in run.rest) < line.length_m - _SAME_PLACE_M:
                report.collapsed["line cut where another material lies on it"] += 1
                rest = [span for span in run.rest if span[1] - span[0] >= _SHORTEST_M]
                pieces[id(line)] = [_line(direction, offset, span, line) for span in rest]
            runs.setdefault(place, []).append(run)
    return [piece for line in lines for piece in pieces[id(line)]]


def _line(direction: Array, offset: float, span: Interval, like: Line) -> Line:
    """A line of a family, with the material and source of another."""
    normal = np.array([-direction[1], direction[0]])
    start, end = (at * direction + offset * normal for at in span)
    return replace(like, start_m=(float(start[0]), float(start[1])), end_m=(float(end[0]), float(end[1])))


def _are_caps(lines: list[Line], centres: list[Line]) -> NDArray[np.bool_]:
    """Whether lines cross an end of a collapsed wall of their material from face to face; shape (lines,)."""
    caps = np.zeros(len(lines), dtype=np.bool_)
    if not lines or not centres:
        return caps
    start, end = np.moveaxis(np.array([(line.start_m, line.end_m) for line in lines]), 1, 0)
    tips = np.array([(centre.start_m, centre.end_m) for centre in centres])
    length, drawn = np.linalg.norm(end - start, axis=1), np.array([centre.drawn_m for centre in centres])
    # A cap is as long as the wall is thick, but for a tenth, and no farther from its end than that.
    tree = shapely.STRtree(shapely.points(tips.reshape(-1, 2)))
    middles = shapely.points(0.5 * (start + end))
    line, tip = tree.query(middles, predicate="dwithin", distance=1.2 * length)
    centre = tip // 2
    materials = {name: number for number, name in enumerate({each.material for each in (*lines, *centres)})}
    made_of, of_centres = (np.array([materials[each.material] for each in some]) for some in (lines, centres))
    thickness = drawn[centre]
    alike = (made_of[line] == of_centres[centre]) & (np.abs(length[line] - thickness) <= 0.1 * thickness)
    line, tip, centre, thickness = line[alike], tip[alike], centre[alike], thickness[alike]
    direction = tips[centre, 1] - tips[centre, 0]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    offset = 0.5 * (start[line] + end[line]) - tips[centre, tip % 2]
    at = np.sum(offset * direction, axis=1)
    across = np.abs(direction[:, 0] * offset[:, 1] - direction[:, 1] * offset[:, 0])
    slant = np.abs(np.sum((end[line] - start[line]) * direction, axis=1)) / length[line]
    found = (slant < 0.1) & (across < 0.1 * thickness) & (np.abs(at) <= thickness)
    caps[line[found]] = True
    return caps
