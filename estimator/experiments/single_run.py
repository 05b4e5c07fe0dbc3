"""Fig. 14: one run of each method as a map."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from estimator.evaluation.picture_style import STYLE
from estimator.experiments.cases import cases_of
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.report import Report, Row, figure_text
from estimator.experiments.room import Room
from estimator.experiments.room_map import draw_result, draw_room
from estimator.experiments.runs import Run, Score, watch
from estimator.experiments.summary import summarise
from estimator.result import SlamResult

__all__ = ["reproduce"]


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Run every case and draw the first run of each."""
    room, runs = request.room, request.runs or entry.runs
    cases = cases_of(request.methods or entry.methods, request.engine, every_engine=False)
    tasks = [Run(room, case, request.seed + i, request.particles) for case in cases for i in range(runs)]
    watched: list[tuple[SlamResult, Score]] = request.map(watch, tasks)
    summary: dict[str, Any] = {}
    drawn: dict[str, SlamResult] = {}
    rows: list[Row] = []
    for number, case in enumerate(cases):
        mine = watched[number * runs : (number + 1) * runs]
        numbers = summary[case.key] = summarise([score for _, score in mine], None, room)
        drawn[case.key] = mine[0][0]
        walls = int(mine[0][0].wall_valid[-1].sum())
        rows += [
            Row(case.key, ""),
            Row("  error at the end, m", _text(numbers, "mae_final_m")),
            Row("    rotation removed, m", _text(numbers, "derotated_rmse_final_m")),
            Row("  VRP OSPA at the end, m", _text(numbers, "vrp_ospa_final_m")),
            Row("  walls drawn", f"{walls}", "some missed" if case.method == "va" else ""),
            Row("  false walls per run", _text(numbers, "walls_false_per_run")),
        ]
    return Report(
        name,
        entry.title,
        summary,
        {key: _places(result) for key, result in drawn.items()},
        rows,
        _picture(room, drawn),
        (f"The maps are of seed {request.seed}.",),
        {"room": room.name, "runs": runs, "seed": request.seed, "particles": request.particles},
    )


def _text(numbers: dict[str, Any], key: str) -> str:
    return figure_text(numbers[key], numbers[f"{key}_se"])


def _places(result: SlamResult) -> dict[str, Any]:
    """Track, anchors and VRPs relative to RP, as JSON."""
    return {
        "track_m": result.agent_mean[:, :2].tolist(),
        "anchors_m": result.anchor_mean_m[-1][result.anchor_valid[-1]].tolist(),
        "vrps_m": result.wall_mean_m[-1][result.wall_valid[-1]].tolist(),
    }


def _picture(room: Room, drawn: dict[str, SlamResult]) -> Figure:
    with mpl.rc_context(STYLE):
        size = (4.6 * len(drawn), 4.2)
        figure = Figure(figsize=size, dpi=150, facecolor="white", layout="constrained")
        panels = figure.subplots(1, len(drawn), squeeze=False)[0]
        for axes, (key, result) in zip(panels, drawn.items(), strict=True):
            draw_room(axes, room)
            draw_result(axes, room, result)
            axes.set(title=key)
        figure.draw_without_rendering()
    return figure
