"""The commands of twins: `twin` writes the map as a floor plan, `predict` traces a plan anywhere."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import made_parents
from service.cli.progress import Reporter

if TYPE_CHECKING:
    import numpy as np

    from estimator.measurements import MeasurementSet
    from estimator.result import SlamResult
    from raytrace.plan.floorplan import FloorPlan

__all__ = ["register"]

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command(
        epilog=_examples(
            "twin room-result.nc --measurements room-measurements.nc --out twin.toml",
            "twin room-result.nc --measurements room-measurements.nc --out twin.toml --score other-walk",
        )
    )(twin)
    app.command(
        epilog=_examples("predict twin.toml --at walk.csv", "predict twin.toml --at walk.csv --out walk.json")
    )(predict)


def _examples(*lines: str) -> str:
    return "[bold]Examples[/]\n\n" + "\n\n".join(f"  $ hapslam {line}" for line in lines)


def twin(
    result: Annotated[Path, typer.Argument(help="Result file.")],
    measurements: Annotated[
        Path, typer.Option(metavar="FILE", help="The measurements that the result was made of.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="PLAN", help="Floor plan to write (TOML).", callback=made_parents)
    ],
    agent_height: Annotated[
        float, typer.Option(min=0.1, help="Height of the agent over the floor, metres: nothing tells it.")
    ] = 1.5,
    score: Annotated[
        Path | None,
        typer.Option(metavar="DATASET", help="Hold it against another dataset of the same rooms."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="DATASET", help="Dataset that was mapped; by default the one that the result names."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="True coverage, predicted coverage and their difference: .png, .svg or .pdf.",
            callback=made_parents,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write the estimated map as a floor plan that can be traced again."""
    from estimator.dataset import require_absent
    from estimator.measurement_files import load_measurements
    from estimator.result import load_result
    from estimator.slam.smoothing.refine import refine
    from raytrace.plan.files import save_floorplan
    from service.session.twin_plan import twin_of

    require_absent(out)
    found, measured = load_result(result), load_measurements(measurements)
    if found.joint is None:
        found = refine(measured, found)
    if found.flagged.any():
        first = int(found.epoch[found.flagged.argmax()])
        share = f"{int(found.flagged.sum())} of {len(found.epoch)} epochs from {first} on"
        Reporter().say(f"hapslam: note: the run doubts itself in {share}; so does this twin")
    plan = twin_of(found, measured, out.stem[:100], agent_height)
    save_floorplan(plan, out)
    facts = _facts(plan, out)
    if picture is not None:
        _draw(plan, result, found, truth, picture)
    if score is not None:
        frame = _mapped_frame(result, found, truth)
        facts["score"] = _trial(plan, score, frame, found, measured)
    _tell(facts, as_json)


def predict(
    plan: Annotated[
        str, typer.Argument(metavar="PLAN", help="Floor plan file, or the name of a shipped scene.")
    ],
    at: Annotated[Path, typer.Option(metavar="TRACK", help="Where: TUM, or columns time, x, y.")],
    depth: Annotated[
        int | None, typer.Option(min=0, max=3, help="Most bounces; by default the plan's.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="JSON file to write, paths included.", callback=made_parents),
    ] = None,
) -> None:
    """Predict channels where nobody was: power, delay spread, line of sight, paths."""
    import numpy as np

    from estimator.dataset import require_absent, write_text
    from estimator.readers.trajectories import read_track
    from raytrace.plan.files import load_floorplan
    from raytrace.prediction.channels import predict as run
    from raytrace.prediction.tables import channel_rows, path_lists

    if out is not None:
        require_absent(out)
    loaded, track = load_floorplan(plan), read_track(at)
    channels = run(loaded, track.position_m[:, :2], depth)
    names = [anchor.name for anchor in loaded.anchors]
    rows = channel_rows(channels, names, np.asarray(track.time_s), track.position_m)
    if out is None:
        _say(",".join(rows[0]))
        for row in rows:
            _say(",".join("" if value is None else str(value) for value in row.values()))
        return
    document = {
        "plan": loaded.name,
        "sha256": loaded.sha256(),
        "channels": rows,
        "paths": path_lists(channels, names),
    }
    write_text(json.dumps(document, allow_nan=False) + "\n", out)


def _mapped_frame(result: Path, found: SlamResult, truth: Path | None) -> tuple[np.ndarray[Any, Any], float]:
    """Where the mapped track began in the true plan, and the estimator's x axis there."""
    from estimator.pipeline import find_truth

    known = find_truth(result, found, truth)
    return known.attrs["start_m"], float(known.attrs["heading_rad"])


def _draw(plan: FloorPlan, result: Path, found: SlamResult, truth: Path | None, out: Path) -> None:
    from estimator.evaluation.pictures import require_picture_name, save_figure
    from estimator.pipeline import find_truth
    from raytrace.dataset.shards import stored_plan
    from raytrace.prediction.pictures import draw_comparison

    require_picture_name(out)
    true = stored_plan(find_truth(result, found, truth))
    frame = _mapped_frame(result, found, truth)
    save_figure(draw_comparison(true, plan, *frame, found.agent_mean[:, :2]), out)


def _trial(
    plan: FloorPlan,
    score: Path,
    frame: tuple[np.ndarray[Any, Any], float],
    found: SlamResult,
    measured: MeasurementSet,
) -> dict[str, Any]:
    from estimator.dataset import open_dataset
    from estimator.twin.powers import measured_powers_db
    from raytrace.prediction.heldout import held_out
    from raytrace.prediction.trial import trial

    columns = [found.anchors.index(anchor.name) for anchor in plan.anchors]
    powers = measured_powers_db(measured)[:, columns]
    return trial(plan, held_out(open_dataset(score)), *frame, found.agent_mean[:, :2], powers)


def _facts(plan: FloorPlan, out: Path) -> dict[str, Any]:
    known = plan.uncertainty
    assert known is not None  # a twin states it
    assumed = sum(entry.assumed for entry in known.walls)
    open_ends = sum((entry.from_end == "open") + (entry.to_end == "open") for entry in known.walls)
    return {
        "plan": os.fspath(out),
        "walls": len(plan.walls) - assumed - sum(len(entry.walls) for entry in known.obstacles),
        "assumed_walls": assumed,
        "open_ends": open_ends,
        "obstacles": len(known.obstacles),
        "anchors": len(plan.anchors),
        "materials": {
            wall.name: f"{wall.material} {wall.thickness_m:g} m"
            for wall in plan.walls[: len(known.walls)]  # the obstacles' follow
        },
    }


def _tell(facts: dict[str, Any], as_json: bool) -> None:
    if as_json:
        _say(json.dumps(facts, indent=2, allow_nan=False))
        return
    for name, value in facts.items():
        if name == "score":
            _tell_score(value)
        elif name == "materials":
            _say(f"{'materials':<20} {', '.join(f'{wall} {told}' for wall, told in value.items())}")
        else:
            _say(f"{name.replace('_', ' '):<20} {value}")


def _tell_score(score: dict[str, Any]) -> None:
    _say(
        f"{'positions':<20} {score['positions']}, {100 * score['far_share']:.0f} % far from the mapped track"
    )
    for name in ("twin", "true_plan"):
        told = score[name]
        _say(
            f"{name.replace('_', ' '):<20} power {_pair(told['power_db'])} dB, "
            f"400 MHz {_pair(told['wideband_db'])} dB, "
            f"paths {_pair(told['path_power_db'])} dB and {_pair(told['path_delay_ns'])} ns, explained "
            f"{told['explained']:.3f}, invented {told['invented']:.3f}, "
            f"line of sight right {told['line_of_sight_right']:.3f}"
        )
    for name, told in score["interpolations"].items():
        _say(f"{name:<20} power {_pair(told['power_db'])} dB, far {_pair(told['far']['power_db'])} dB")
    ends = score["ends_m"]
    if ends["count"]:
        _say(
            f"{'wall ends':<20} mean {ends['mean']:.3f} m, largest {ends['largest']:.3f} m of {ends['count']}"
        )


def _pair(values: list[float] | None) -> str:
    return "none" if values is None else f"{values[0]:.2f}/{values[1]:.2f}"


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
