"""Fig. 13: localisation and mapping errors of the methods over the steps, many runs each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.evaluation.picture_style import DASHES, MUTED, STYLE, colour_of, logarithmic, tidy
from estimator.experiments.cases import Case, cases_of, limit_of
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.report import Report, Row, figure_text
from estimator.experiments.runs import Run, Score, perform
from estimator.experiments.summary import limit_curves, score_curves, summarise

__all__ = ["reproduce"]

Curves = Mapping[str, NDArray[np.float64]]

_PAPER: dict[str, dict[str, str]] = {  # Section V-E3, read from the text
    "hybrid": {"mae_final_m": "0.4", "vrp_ospa_final_m": "1", "converged_step": "3"},
    "mva": {"mae_final_m": "0.05", "vrp_ospa_final_m": "0.1", "converged_step": "30"},
    "va": {"converged_step": "45"},
}
_QUANTITIES = (
    ("mae_final_m", "MAE at the end, m", 3),
    ("rmse_final_m", "RMSE at the end, m", 3),
    ("derotated_rmse_final_m", "  rotation removed, m", 3),
    ("nees_position_per_dim", "NEES per dimension", 2),
    ("vrp_ospa_final_m", "VRP OSPA at the end, m", 3),
    ("converged_step", "mapping converged at step", 0),
    ("new_wall_delay_median", "new wall found after, steps", 0),
    ("walls_false_per_run", "false walls per run", 3),
    ("seconds_per_run", "processor time per run, s", 2),
)
_PANELS = (
    ("mae_m", "mean position error, m"),
    ("derotated_rmse_m", "RMSE, rotation removed, m"),
    ("vrp_ospa_m", "mean OSPA of VRPs, m"),
)


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Run all cases on the same seeds and compare them."""
    room, runs = request.room, request.runs or entry.runs
    cases = cases_of(request.methods or entry.methods, request.engine)
    tasks = [Run(room, case, request.seed + i, request.particles) for case in cases for i in range(runs)]
    scores: list[Score] = request.map(perform, tasks)
    summary: dict[str, Any] = {}
    curves: dict[str, Curves] = {}
    limits: dict[str, Curves] = {}
    rows: list[Row] = []
    for number, case in enumerate(cases):
        mine = scores[number * runs : (number + 1) * runs]
        limit = limit_of(room, case)
        summary[case.key] = summarise(mine, limit, room)
        curves[case.key] = score_curves(mine)
        if limit is not None:
            limits[case.key] = limit_curves(limit, room)
        rows += _rows(case, summary[case.key])
    return Report(
        name,
        entry.title,
        summary,
        {"curves": _lists(curves), "limits": _lists(limits)},
        rows,
        _picture(curves, limits),
        (
            "OSPA (order 1, cut-off 10 m) against the walls sensed at the start and those that reflected "
            "by then; limits are posterior Cramer-Rao bounds with known associations.",
            "Run i of every case has the measurements of seed + i.",
        ),
        {"room": room.name, "runs": runs, "seed": request.seed, "particles": request.particles},
    )


def _rows(case: Case, numbers: Mapping[str, Any]) -> list[Row]:
    limit = numbers["limit"] or {}
    paper = _PAPER.get(case.name, {})
    rows = [Row(case.key, ""), Row("  runs lost", f"{numbers['lost']} of {numbers['runs']}")]
    for key, text, digits in _QUANTITIES:
        ours = figure_text(numbers[key], numbers.get(f"{key}_se"), digits)
        bound = figure_text(limit[key], digits=digits) if key in limit else ""
        rows.append(Row(f"  {text}", ours, paper.get(key, ""), bound))
    return rows


def _lists(curves: Mapping[str, Curves]) -> dict[str, dict[str, list[float]]]:
    return {key: {name: line.tolist() for name, line in lines.items()} for key, lines in curves.items()}


def _picture(curves: Mapping[str, Curves], limits: Mapping[str, Curves]) -> Figure:
    """One panel for each quantity over the steps; limits are dashed in the colour of their method."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 9.5), dpi=150, facecolor="white", layout="constrained")
        for axes, (name, label) in zip(figure.subplots(len(_PANELS), 1, sharex=True), _PANELS, strict=True):
            for number, (key, lines) in enumerate(curves.items()):
                colour, steps = colour_of(number), np.arange(1, len(lines[name]) + 1)
                axes.plot(steps[1:], lines[name][1:], color=colour, linewidth=1.4, label=key)
                if key in limits:
                    axes.plot(steps[1:], limits[key][name][1:], color=colour, linewidth=1.0, linestyle=DASHES)
            axes.plot([], [], color=MUTED, linewidth=1.0, linestyle=DASHES, label="limit")
            axes.set(ylabel=label)
            logarithmic(axes)
            tidy(axes)
        axes.set(xlabel="step")
        figure.axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, ncols=4)
        figure.draw_without_rendering()
    return figure
