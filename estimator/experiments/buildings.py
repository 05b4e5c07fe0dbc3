"""Many buildings: how often runs are lost, how often they say so, and how good the others are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.evaluation.picture_style import AGENT, AGENT_TRUE, INK, STYLE, TRUE, WALL, tidy
from estimator.experiments.building_runs import SENSING, BuildingRun, BuildingScore, Sketch
from estimator.experiments.report import Report, Row

__all__ = ["ANCHOR_GATE_M", "report_of", "summary_of"]

ANCHOR_GATE_M = 0.3  # within which an anchor counts as placed; in the name of its figure
_DRAWN = 6  # of the worst runs
_EXACT_M = 1e-3  # errors below this are equally good, in ratios
_NAMES = {"hybrid": "all sensed", "echo_only": "echoes alone", "passive_only": "paths and first sweep alone"}


def summary_of(runs: Sequence[BuildingRun]) -> dict[str, Any]:
    """Figures of runs by kind, and of ``all`` (JSON types).

    Parameters
    ----------
    runs : sequence of BuildingRun
        In any order.

    Returns
    -------
    dict
        For each kind and for ``all`` an object of

        - ``runs``; ``refused``: those whose measurements the engine refused, which do not count below;
        - ``lost``: runs whose RMSE with rotation removed is beyond 1 m; ``silent``: those of them that never
          said so; ``flagged_good``: runs not lost that were ever doubtful or lost by their own judgement;
        - ``mae_median_m``, ``mae_p95_m``: over runs, of their mean position errors;
        - ``limit_median_m``: over runs, of the mean of the position's limit with all that was sensed;
        - ``nees_median``: over runs, of the position's NEES per dimension;
        - ``anchors_within_0_3_m``: share of the anchors heard in 20 epochs or more;
        - ``walls_found``: share of the walls that should have been found; ``walls_false_per_run``;
        - ``protection_held``: share of the epochs not flagged whose error was below the protection level;
        - ``seconds_per_epoch_median``, ``seconds_per_epoch_max``: processor time of a step;
        - ``mae_ratio_median``, ``mae_ratio_p95``: over runs, of the MAE over that of the better half, errors
          below a millimetre taken as one;
        - ``echo_only`` and ``passive_only``: the same figures of these runs, limit and ratios excepted.

        A figure of nothing is null.
    """
    kinds = sorted({run.kind for run in runs}, key=[run.kind for run in runs].index)
    groups = {kind: [run for run in runs if run.kind == kind] for kind in kinds}
    return {name: _figures(group) for name, group in {**groups, "all": list(runs)}.items()}


def _figures(runs: Sequence[BuildingRun]) -> dict[str, Any]:
    whole, *halves = ([run.scores[name] for run in runs] for name in SENSING)
    ratios = [
        max(ours.mae_m, _EXACT_M) / max(min(better), _EXACT_M)
        for ours, *others in zip(whole, *halves, strict=True)
        if ours is not None and (better := [other.mae_m for other in others if other is not None])
    ]
    return {
        **_of_scores(whole),
        "limit_median_m": _at([run.limit_m.mean() for run in runs], 50),
        "mae_ratio_median": _at(ratios, 50),
        "mae_ratio_p95": _at(ratios, 95),
        **{name: _of_scores(scores) for name, scores in zip(SENSING[1:], halves, strict=True)},
    }


def _of_scores(given: Sequence[BuildingScore | None]) -> dict[str, Any]:
    scores = [score for score in given if score is not None]
    errors = [score.mae_m for score in scores]
    anchors = np.concatenate([[], *(score.anchors_error_m for score in scores)])
    told = np.concatenate([[], *(score.protected[~score.flagged] for score in scores)])
    seconds = np.concatenate([[], *(score.seconds for score in scores)])
    due = sum(score.walls_due for score in scores)
    return {
        "runs": len(given),
        "refused": len(given) - len(scores),
        "lost": sum(score.lost for score in scores),
        "silent": sum(score.silent for score in scores),
        "flagged_good": sum(not score.lost and bool(score.flagged.any()) for score in scores),
        "mae_median_m": _at(errors, 50),
        "mae_p95_m": _at(errors, 95),
        "nees_median": _at([score.nees for score in scores if score.nees is not None], 50),
        "anchors_within_0_3_m": _mean(anchors < ANCHOR_GATE_M),
        "walls_found": sum(score.walls_found for score in scores) / due if due else None,
        "walls_false_per_run": _mean([score.walls_false for score in scores]),
        "protection_held": _mean(told),
        "seconds_per_epoch_median": _at(seconds, 50),
        "seconds_per_epoch_max": _at(seconds, 100),
    }


def _at(values: Any, percentile: float) -> float | None:
    return float(np.percentile(values, percentile)) if len(values) else None


def _mean(values: Any) -> float | None:
    return float(np.mean(values)) if len(values) else None


def report_of(runs: Sequence[BuildingRun], settings: Mapping[str, Any]) -> Report:
    """Figures, and a picture of the worst runs.

    Parameters
    ----------
    runs : sequence of BuildingRun
        In the order in which they are told.
    settings : mapping
        How they were made, for the record (JSON types).
    """
    summary = summary_of(runs)
    keys = ("lost", "silent", "flagged_good", "mae_median_m", "mae_p95_m", "walls_false_per_run")
    rows = [Row("", ", ".join(keys))]
    for kind, figures in summary.items():
        for name in SENSING:
            of = figures if name == "hybrid" else figures[name]
            values = ", ".join(_text(of[key]) for key in keys)
            rows.append(Row(f"{kind} ({of['runs']}), {_NAMES[name]}", values))
    data = {
        f"{run.kind}-{run.number}": {
            name: None
            if score is None
            else {"mae_m": score.mae_m, "lost": score.lost, "flagged_epochs": int(score.flagged.sum())}
            for name, score in run.scores.items()
        }
        for run in runs
    }
    return Report(
        "buildings",
        "Random buildings mapped: lost, silently lost, errors",
        summary,
        data,
        rows,
        _picture(runs),
        ("The picture shows the runs with the largest errors, in the estimator's frame.",),
        settings,
    )


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value}" if isinstance(value, int) else f"{value:.3f}"


def _picture(runs: Sequence[BuildingRun]) -> Figure:
    drawn = [(run, run.scores["hybrid"], run.sketch) for run in runs]
    known = [(run, score, sketch) for run, score, sketch in drawn if score is not None and sketch is not None]
    worst = sorted(known, key=lambda one: -one[1].mae_m)[:_DRAWN]
    with mpl.rc_context(STYLE):
        columns = min(3, max(len(worst), 1))
        lines = -(-max(len(worst), 1) // columns)
        size = (4.2 * columns, 5.2 * lines + 0.5)
        figure = Figure(figsize=size, dpi=130, facecolor="white", layout="constrained")
        ratios = [3.4, 1.2] * lines
        panels = figure.subplots(2 * lines, columns, squeeze=False, height_ratios=ratios)
        maps, errors = panels[::2].ravel(), panels[1::2].ravel()
        for axes in [*maps[len(worst) :], *errors[len(worst) :]]:
            axes.set_axis_off()
        for axes, below, (run, score, sketch) in zip(maps, errors, worst, strict=False):
            _draw(axes, sketch)
            said = f"flagged in {int(score.flagged.sum())} of {len(score.flagged)}"
            axes.set_title(f"{run.kind} {run.number}: {score.mae_m:.2f} m, {said}", loc="left", fontsize=9.0)
            _draw_errors(below, score.error_m, run.limit_m)
        if worst:
            both = [axes.get_legend_handles_labels() for axes in (maps[0], errors[0])]
            handles, labels = ([*upper, *lower] for upper, lower in zip(*both, strict=True))
            figure.legend(
                handles,
                labels,
                loc="outside lower center",
                ncols=2 * min(columns, 2),
                frameon=False,
                fontsize=9.0,
            )
        figure.draw_without_rendering()  # lays out while the style holds
    return figure


def _draw_errors(axes: Axes, error_m: NDArray[np.float64], limit_m: NDArray[np.float64]) -> None:
    """The error, and the limit that no filter can beat on average, by epoch."""
    floor = 1e-4  # of the drawing: at the first epoch both are zero
    axes.semilogy(np.maximum(error_m, floor), color=AGENT, linewidth=1.2, label="error")
    axes.semilogy(np.maximum(limit_m, floor), color=INK, linewidth=1.0, linestyle="--", label="limit")
    axes.set(xlabel="epoch", ylabel="m", ylim=(1e-3, 30.0))
    tidy(axes)


def _draw(axes: Axes, sketch: Sketch) -> None:
    """True walls and track beneath, estimated ones above; framed by what is true."""
    for row, wall in enumerate(sketch.walls_m):
        axes.plot(*wall.T, color=TRUE, linewidth=4.0, label="wall, true" if row == 0 else None, zorder=1)
    axes.plot(*sketch.track_m.T, color=AGENT_TRUE, linewidth=3.0, label="track, true", zorder=2)
    for row, wall in enumerate(sketch.found_m):
        label = "wall, estimated" if row == 0 else None
        axes.plot(*wall.T, color=WALL, linewidth=1.4, label=label, zorder=3)
    axes.plot(*sketch.estimate_m.T, color=AGENT, linewidth=1.2, label="track, estimated", zorder=4)
    corners = np.concatenate([sketch.walls_m.reshape(-1, 2), sketch.track_m])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.1 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(aspect="equal", xlabel="x, m", ylabel="y, m")
    tidy(axes)
