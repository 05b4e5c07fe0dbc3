"""Fig. 12: how paths refine the walls that active sensing saw at the start, and find another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.evaluation.comparison import EvaluationConfig
from estimator.evaluation.metrics import best_rotation, derotated, match
from estimator.evaluation.picture_style import AGENT, ANCHOR, INK, MUTED, STYLE, WALL, tidy
from estimator.experiments.cases import cases_of, limit_of
from estimator.experiments.catalogue import Entry, Request
from estimator.experiments.report import Report, Row, figure_text
from estimator.experiments.room import Room
from estimator.experiments.room_map import draw_ellipse
from estimator.experiments.runs import Run, Score, watch
from estimator.experiments.summary import mean_of, rms_of
from estimator.geometry import mirror_in_wall
from estimator.measurements import GaussianVrp
from estimator.result import SlamResult
from estimator.sensing.linefit import seen_from_reference
from estimator.simulate import SimulationConfig, walls_in_view

__all__ = ["reproduce"]

Array = NDArray[np.float64]

_TRAVELLED_M = (30.0, 115.0)  # the paper's t = 300 and 1,150 at 0.1 m a step
_GATE_M = EvaluationConfig().wall_gate_m


@dataclass(frozen=True, eq=False)
class _Seen:
    """A wall in a run at a step: error of its VRP and claimed covariance."""

    mean_m: Array
    covariance_m2: Array
    error_m: float

    @property
    def std_m(self) -> float:
        return float(np.sqrt(np.trace(self.covariance_m2)))


def reproduce(name: str, entry: Entry, request: Request) -> Report:
    """Run the cases and follow each wall's VRP; the picture shows the first run of the first case."""
    room, runs = request.room, request.runs or entry.runs
    cases = cases_of(request.methods or entry.methods, request.engine, every_engine=False)
    tasks = [Run(room, case, request.seed + i, request.particles) for case in cases for i in range(runs)]
    watched: list[tuple[SlamResult, Score]] = request.map(watch, tasks)
    results = [result for result, _ in watched]
    steps = [_step_at(room, travelled) for travelled in _TRAVELLED_M]
    active = _active(room, steps[-1])
    summary: dict[str, Any] = {}
    rows: list[Row] = []
    for number, case in enumerate(cases):
        mine = results[number * runs : (number + 1) * runs]
        seen = [{step: _walls_at(result, room, step) for step in steps} for result in mine]
        limit = limit_of(room, case)
        rows.append(Row(case.key, ""))
        walls = []
        for wall in np.flatnonzero(room.walls_due[-1]).tolist():
            numbers = _before_and_instead(room, wall, active)
            for step in steps:
                here = [run[step][wall] for run in seen if wall in run[step]]
                bound = None if limit is None or not room.walls_due[step, wall] else limit
                numbers[f"step_{step + 1}"] = _refined(
                    here, None if bound is None else bound.wall_covariance_m2[step, wall]
                )
            walls.append(numbers)
            rows += _rows(numbers, steps)
        summary[case.key] = {"runs": runs, "walls": walls}
    return Report(
        name,
        entry.title,
        summary,
        {},
        rows,
        _picture(room, steps, results[0], active, cases[0].name),
        (
            "Deviations are roots of the covariance's trace; errors are roots of mean squares over runs.",
            "Active sensing alone: a sweep at the agent's place, which is taken as known, with the variance "
            "that the paper's four follow (8.9e-4 of the squared distance); it sees the walls that the agent "
            "faces squarely.",
        ),
        {"room": room.name, "runs": runs, "seed": request.seed, "particles": request.particles},
    )


def _before_and_instead(room: Room, wall: int, active: dict[int, GaussianVrp]) -> dict[str, Any]:
    """A wall by active sensing, at the start and late."""
    prior, sweep = room.sensed.get(wall), active.get(wall)
    return {
        "vrp_m": (room.scenario.vrps_m[wall] + room.scenario.track_m[0]).tolist(),
        "std_prior_m": None if prior is None else float(np.sqrt(2.0 * prior)),
        "std_active_only_m": None if sweep is None else float(np.sqrt(np.trace(sweep.covariance_m2))),
    }


def _refined(here: list[_Seen], bound_m2: Array | None) -> dict[str, Any]:
    """A wall at a step, over the runs that found it."""
    error, error_se = rms_of([one.error_m for one in here])
    return {
        "found": len(here),
        "std_claimed_m": mean_of([one.std_m for one in here])[0],
        "rmse_m": error,
        "rmse_m_se": error_se,
        "limit_m": None if bound_m2 is None else float(np.sqrt(np.trace(bound_m2))),
    }


def _rows(numbers: dict[str, Any], steps: list[int]) -> list[Row]:
    x, y = numbers["vrp_m"]
    prior, alone = numbers["std_prior_m"], numbers["std_active_only_m"]
    rows = [
        Row(f"  VRP [{x:.0f}, {y:.0f}]", ""),
        Row("    active sensing at step 1, m", figure_text(prior)),
    ]
    for step, travelled in zip(steps, _TRAVELLED_M, strict=True):
        one = numbers[f"step_{step + 1}"]
        error = figure_text(one["rmse_m"], one["rmse_m_se"])
        found = f"{figure_text(one['std_claimed_m'])} claimed, error {error}" if one["found"] else "-"
        paper = "smaller" if one["found"] else ""
        rows.append(
            Row(f"    step {step + 1} ({travelled:g} m on), m", found, paper, figure_text(one["limit_m"]))
        )
    paper = "" if alone is None else "much larger"
    rows.append(Row(f"    active sensing alone at step {steps[-1] + 1}, m", figure_text(alone), paper))
    return rows


def _step_at(room: Room, travelled_m: float) -> int:
    """First epoch at which the agent has gone so far, or the last."""
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(room.track_m, axis=0), axis=1))])
    return min(int(np.sum(gone < travelled_m - 1e-6)), room.steps - 1)


def _walls_at(result: SlamResult, room: Room, step: int) -> dict[int, _Seen]:
    """Estimates of the true walls at an epoch, told apart with the track's rotation removed."""
    columns = np.flatnonzero(result.wall_valid[step])
    means = result.wall_mean_m[step, columns].reshape(-1, 2)
    turn = float(best_rotation(result.agent_mean[:, :2], room.track_m))
    vrps = room.scenario.vrps_m
    return {
        wall: _Seen(
            means[i],
            result.wall_covariance_m2[step, columns[i]],
            float(np.linalg.norm(means[i] - vrps[wall])),
        )
        for i, wall in match(derotated(means, turn), vrps, _GATE_M)
    }


def _active(room: Room, step: int) -> dict[int, GaussianVrp]:
    """Walls that a sweep at an epoch sees, as VRPs; their means are the true ones."""
    plan, variance = room.scenario, SimulationConfig().sweep_variance
    position = plan.track_m[step]
    images = mirror_in_wall(position, plan.start_m, plan.end_m) - position
    return {
        wall: seen_from_reference(
            images[wall],
            variance * 0.25 * float(images[wall] @ images[wall]) * np.eye(2),
            room.track_m[step],
        )
        for wall in walls_in_view(plan.start_m, plan.end_m, position)
    }


def _picture(
    room: Room, steps: list[int], result: SlamResult, active: dict[int, GaussianVrp], method: str
) -> Figure:
    """A panel for each wall: its VRP as sensed at the start, as refined, and as a late sweep sees it."""
    seen = {step: _walls_at(result, room, step) for step in steps}
    walls = np.flatnonzero(room.walls_due[-1]).tolist()
    origin = room.scenario.track_m[0]
    with mpl.rc_context(STYLE):
        columns = min(3, len(walls))
        count = -(-len(walls) // columns)
        size = (3.4 * columns, 3.4 * count)
        figure = Figure(figsize=size, dpi=150, facecolor="white", layout="constrained")
        panels = figure.subplots(count, columns, squeeze=False).ravel()
        for axes, wall in zip(panels, walls, strict=False):
            place = room.scenario.vrps_m[wall] + origin
            variance = room.sensed.get(wall)
            if variance is not None:
                draw_ellipse(axes, place, variance * np.eye(2), MUTED, "active, step 1")
            if wall in active:
                draw_ellipse(axes, place, active[wall].covariance_m2, ANCHOR, f"active, step {steps[-1] + 1}")
            for step, colour in zip(steps, (AGENT, WALL), strict=True):
                one = seen[step].get(wall)
                if one is not None:
                    draw_ellipse(
                        axes, one.mean_m + origin, one.covariance_m2, colour, f"{method}, step {step + 1}"
                    )
            axes.plot(*place, marker="+", markersize=8.0, color=INK, linestyle="", label="true", zorder=5)
            _frame(axes, place)
        for axes in panels[len(walls) :]:
            axes.set_axis_off()
        figure.draw_without_rendering()
    return figure


def _frame(axes: Axes, place: Array) -> None:
    """Equal axes that hold all ellipses of a panel."""
    axes.set(title=f"VRP [{place[0]:.0f}, {place[1]:.0f}]", aspect="equal", xlabel="x, m", ylabel="y, m")
    axes.set(adjustable="datalim")
    axes.autoscale_view()
    tidy(axes)
    axes.legend(frameon=False, fontsize=6.5, loc="upper right")
