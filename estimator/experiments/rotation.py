"""Fig. 11: paths alone leave the map free to turn; walls sensed at the start hold it."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from estimator.evaluation.picture_style import ANCHOR, DASHES, STYLE
from estimator.experiments.cases import Case, cases_of, limit_of
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.report import Report, Row, figure_text
from estimator.experiments.room import Room
from estimator.experiments.room_map import draw_ellipse, draw_result, draw_room
from estimator.experiments.runs import Run, Score, watch
from estimator.experiments.summary import summarise
from estimator.result import SlamResult

__all__ = ["reproduce"]


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Run every case; draw its anchors when they are first known, and its map at the end."""
    room, runs = request.room, request.runs or entry.runs
    cases = cases_of(request.methods or entry.methods, request.engine, every_engine=False)
    tasks = [Run(room, case, request.seed + i, request.particles) for case in cases for i in range(runs)]
    watched: list[tuple[SlamResult, Score]] = request.map(watch, tasks)
    summary: dict[str, Any] = {}
    drawn: list[tuple[Case, SlamResult]] = []
    rows: list[Row] = []
    for number, case in enumerate(cases):
        mine = watched[number * runs : (number + 1) * runs]
        limit = limit_of(room, case)
        numbers = summary[case.key] = summarise([score for _, score in mine], limit, room)
        numbers["rotation_rad"] = [score.rotation_rad for _, score in mine]
        numbers["anchors_first_step"] = [_first_steps(result) for result, _ in mine]
        drawn.append((case, mine[0][0]))
        rows += _rows(case, numbers)
    return Report(
        name,
        entry.title,
        summary,
        {},
        rows,
        _picture(room, drawn, request.seed),
        (
            f"The maps are of seed {request.seed}; paths alone tell a map up to a rotation about RP and "
            "a mirror image, of which the numbers take the better one.",
            "Circles: the shortest path of the first epoch. Ellipses: two standard deviations at the "
            "step at which the anchor is first located.",
        ),
        {"room": room.name, "runs": runs, "seed": request.seed, "particles": request.particles},
    )


def _rows(case: Case, numbers: dict[str, Any]) -> list[Row]:
    free = case.setting.anchors == "ring"
    limit = numbers["limit"] or {}
    held = "" if free or not limit else f"{np.degrees(limit['rotation_rms_rad']):.2f}"
    root, error = numbers["rotation_rms_rad"], numbers["rotation_rms_rad_se"]
    turned = figure_text(
        float(np.degrees(root)), None if error is None else float(np.degrees(error)), digits=2
    )
    derotated = figure_text(numbers["derotated_rmse_final_m"], numbers["derotated_rmse_final_m_se"])
    paper = {"passive": "rotates", "hybrid": "accurate"}.get(case.name, "")
    bound = "" if not limit else f"{limit['derotated_rmse_final_m']:.3f}"
    return [
        Row(case.key, ""),
        Row("  rotation of the track (RMS), degrees", turned, paper, "free" if free else held),
        Row("  error at the end, rotation removed, m", derotated, "", bound),
        Row("  runs lost, rotation removed", f"{numbers['lost']} of {numbers['runs']}"),
    ]


def _first_steps(result: SlamResult) -> list[int | None]:
    """Step, from 1, at which each anchor is first located."""
    return [int(np.argmax(valid)) + 1 if valid.any() else None for valid in result.anchor_valid.T]


def _picture(room: Room, drawn: list[tuple[Case, SlamResult]], seed: int) -> Figure:
    """A column for each case: anchors when first known, above the map at the end."""
    with mpl.rc_context(STYLE):
        size = (4.8 * len(drawn), 8.2)
        figure = Figure(figsize=size, dpi=150, facecolor="white", layout="constrained")
        columns = figure.subplots(2, len(drawn), squeeze=False).T
        for (upper, lower), (case, result) in zip(columns, drawn, strict=True):
            free = case.setting.anchors == "ring"
            draw_room(upper, room)
            draw_room(lower, room, margin_m=40.0 if free else 6.0)
            if free:
                _draw_circles(upper, room, case, seed)
            else:
                _draw_first(upper, room, result)
            draw_result(lower, room, result)
            upper.set(title=f"{case.key}: anchors at first")
            lower.set(title=f"{case.key}: step {room.steps}")
        figure.draw_without_rendering()
    return figure


def _draw_circles(axes: Axes, room: Room, case: Case, seed: int) -> None:
    """What the first epoch alone tells of the anchors: their distances."""
    x, y = room.scenario.track_m[0]
    for paths in room.measure(case.simulation, seed).epochs[0].paths:
        if len(paths):
            radius = float(paths.range_m.min())
            axes.add_patch(Circle((x, y), radius, fill=False, edgecolor=ANCHOR, linestyle=DASHES))


def _draw_first(axes: Axes, room: Room, result: SlamResult) -> None:
    for k, step in enumerate(_first_steps(result)):
        if step is not None:
            place = result.anchor_mean_m[step - 1, k] + room.scenario.track_m[0]
            draw_ellipse(axes, place, result.anchor_covariance_m2[step - 1, k], ANCHOR)
            axes.plot(*place, marker="^", markersize=5.0, linestyle="", color=ANCHOR, zorder=5)
