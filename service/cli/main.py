"""The command `hapslam`.

Each command is a thin face of one function of the estimator or the ray tracer, which
are imported when the command runs; those of datasets and of the service are in modules
of their own.

Exit status: 0 when all went well, 1 when `doctor`, `verify` or `info` found something bad, 2 when the
input was bad or the system refused (no space, no permission), 3 when `--strict` was asked for and paths
are missing. Errors are one line on the standard error.
"""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from estimator.errors import ConfigurationError, HapslamError
from service.cli.bench import register as register_bench
from service.cli.console import made_parents, plain_console
from service.cli.convert import register as register_convert
from service.cli.dataset import register as register_datasets
from service.cli.experiments import register as register_experiments
from service.cli.missing_paths import STRICT_STATUS, Strict, tell_missing
from service.cli.progress import Reporter
from service.cli.scene import register as register_scenes
from service.cli.service import register
from service.cli.twin import register as register_twins

if TYPE_CHECKING:
    from estimator.experiments.room import Room
    from estimator.measurements import GaussianVrp, MeasurementSet

__all__ = ["app", "main"]

app = typer.Typer(
    name="hapslam",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

# The base of all usage mistakes has no public name.
_UsageError = cast("type[typer.BadParameter]", typer.BadParameter.__bases__[0])
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with what an interrupted run left; begin if there is none.")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all randomness.")]
Truth = Annotated[
    Path | None,
    typer.Option(metavar="DATASET", help="Dataset with the truth; by default the one that the result names."),
]


def _examples(*lines: str) -> str:
    return "[bold]Examples[/]\n\n" + "\n\n".join(f"  $ hapslam {line}" for line in lines)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        print_line(f"hapslam {metadata.version('hapslam')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version.")
    ] = False,
) -> None:
    """From a floor plan to radio channels to a map: hybrid active and passive sensing SLAM."""


@app.command(epilog=_examples("doctor", "doctor --json"))
def doctor(as_json: Json = False) -> None:
    """Look whether everything works here; every problem comes with its remedy."""
    from raytrace.propagation.backend import Check, diagnose
    from service.cli.doctor import as_json as findings_json
    from service.cli.doctor import machine_findings, print_findings

    findings = [*diagnose(), *machine_findings(Check)]
    if as_json:
        _print_json(findings_json(findings))
    else:
        print_findings(findings, plain_console())
    if not all(finding.ok for finding in findings):
        raise typer.Exit(1)


@app.command(epilog=_examples("demo", "demo --scene l-room-hard --seed 3", "demo --out here --json"))
def demo(
    scene: Annotated[str, typer.Option(help="Name of a shipped scene, or a floor plan file.")] = "l-room",
    seed: Seed = 1,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to make; by default a new one in demo-output.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Trace a room while an agent walks through it, map it blindly, compare with the truth."""
    from raytrace.dataset.generate import generate
    from raytrace.plan.files import load_floorplan
    from service.cli.demo import claim_folder, new_folder, run_demo
    from service.cli.report import print_evaluation

    plan = load_floorplan(scene).by_agent()["agent"]
    folder = claim_folder(out) if out is not None else new_folder(f"{plan.name}-seed{seed}")
    numbers = run_demo(
        lambda dataset, advance: generate(plan, dataset, seed, advance),
        folder,
        seed,
        f"{plan.name}, seed {seed}",
        Reporter(quiet),
        _command(),
    )
    if as_json:
        _print_json(numbers)
    else:
        print_evaluation(numbers, plain_console(), picture=folder / "map.png")
    if tell_missing([folder / "dataset"]) and strict:
        raise typer.Exit(STRICT_STATUS)


@app.command(epilog=_examples("extract room --out room-measurements.nc"))
def extract(
    dataset: Annotated[Path, typer.Argument(help="Dataset directory.")],
    out: Annotated[
        Path,
        typer.Option(
            metavar="MEASUREMENTS", help="Measurement file to write (netCDF).", callback=made_parents
        ),
    ],
    diffuse_tail: Annotated[
        bool,
        typer.Option(
            "--diffuse-tail", help="Estimate a diffuse tail with the delays: measured channels, one antenna."
        ),
    ] = False,
    resume: Resume = False,
    quiet: Quiet = False,
) -> None:
    """Estimate delays from the channels and walls from the echoes."""
    from estimator.pipeline import extract_file

    with Reporter(quiet).stage("extract") as advance:
        extract_file(dataset, out, advance, resume, diffuse_tail=diffuse_tail)


@app.command(
    epilog=_examples(
        "slam room-measurements.nc --out room-result.nc",
        "slam room-measurements.nc --floor-plan l-room --out room-result.nc",
    )
)
def slam(
    measurements: Annotated[Path, typer.Argument(help="Measurement file.")],
    out: Annotated[
        Path,
        typer.Option(metavar="RESULT", help="Result file to write (netCDF).", callback=made_parents),
    ],
    method: Annotated[str, typer.Option(help="What is known and sensed.")] = "hybrid",
    engine: Annotated[str, typer.Option(help="How inference is done.")] = "gaussian",
    seed: Seed = 1,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Write the whole run smoothed, each epoch given all of it.")
    ] = False,
    floor_plan: Annotated[
        str | None,
        typer.Option(
            metavar="PLAN", help="Floor plan whose walls are known: TOML, a shipped scene, or a drawing."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="X,Y", help="Where the agent starts in that plan, metres; by default as told."),
    ] = None,
    heading: Annotated[
        float | None, typer.Option(metavar="DEG", help="Direction of the agent's x axis there.")
    ] = None,
    plan_std: Annotated[
        float | None, typer.Option(help="Standard deviation of the plan's walls, metres; 0.05 by default.")
    ] = None,
    resume: Resume = False,
    quiet: Quiet = False,
) -> None:
    """Estimate agent, anchors and walls, epoch by epoch."""
    from estimator.pipeline import slam_file
    from service.cli.known_plan import walls_of_plan

    if floor_plan is None and (start, heading, plan_std) != (None, None, None):
        raise ConfigurationError("--start, --heading, --plan-std: expected with --floor-plan alone")

    def walls(loaded: MeasurementSet) -> Sequence[GaussianVrp]:
        return walls_of_plan(str(floor_plan), loaded, start, heading, plan_std)

    known = None if floor_plan is None else walls
    with Reporter(quiet).stage("slam") as advance:
        slam_file(measurements, out, method, engine, seed, advance, _command(), smooth, known, resume)


@app.command(epilog=_examples("evaluate room-result.nc", "evaluate room-result.nc --truth room --json"))
def evaluate(
    result: Annotated[Path, typer.Argument(help="Result file.")],
    truth: Truth = None,
    truth_track: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="True track instead: TUM, or columns time, x, y."),
    ] = None,
    align: Annotated[
        str, typer.Option(help="Taken off before: start (nothing more), rotation about it, se2.")
    ] = "start",
    truth_anchors: Annotated[
        Path | None, typer.Option(metavar="FILE", help="True anchors: columns anchor, x, y.")
    ] = None,
    clock_offset: Annotated[
        float, typer.Option(help="By how much the clock of the true track is ahead, seconds.")
    ] = 0.0,
    as_json: Json = False,
) -> None:
    """Compare a result with the truth of its dataset, or with a true track."""
    from estimator.pipeline import evaluate_file, evaluate_track_file
    from service.cli.report import print_evaluation, print_track_evaluation

    if truth_track is not None:
        numbers = evaluate_track_file(result, truth_track, align, truth_anchors, clock_offset)
        if as_json:
            _print_json(numbers)
        else:
            print_track_evaluation(numbers, plain_console())
        return
    if align != "start" or truth_anchors is not None or clock_offset != 0.0:
        raise ConfigurationError(
            "--align, --truth-anchors, --clock-offset: expected with --truth-track alone"
        )
    numbers = evaluate_file(result, truth)
    if as_json:
        _print_json(numbers)
    else:
        print_evaluation(numbers, plain_console())


@app.command(epilog=_examples("plot room-result.nc --out map.png", "plot room-result.nc --out map.svg"))
def plot(
    result: Annotated[Path, typer.Argument(help="Result file.")],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Picture to write: .png, .svg or .pdf.", callback=made_parents),
    ],
    truth: Truth = None,
) -> None:
    """Draw the map: walls, anchors, track, uncertainties, and the truth where it is found."""
    from estimator.pipeline import plot_file

    missing = plot_file(result, out, truth)
    if missing:
        Reporter().say(f"hapslam: note: drawn without the truth; {missing}")


def _room(scene: str) -> Room:
    """The room of a scene, as geometry alone."""
    from estimator.experiments.room import make_room
    from raytrace.plan.files import load_floorplan

    plan = load_floorplan(scene)
    step_s = plan.agent.step_m / plan.agent.speed_m_s
    anchors, track = plan.anchors_m()[:, :2], plan.track()[:, :2]
    return make_room(plan.name, *plan.walls_m(), anchors, track, plan.radio.carrier_hz, step_s)


register(app)
register_scenes(app)
register_datasets(app)
register_experiments(app, _room)
register_convert(app)
register_bench(app)
register_twins(app)


def print_line(text: str) -> None:
    """Print a line on the standard output as it is."""
    sys.stdout.write(text + "\n")


def _print_json(value: dict[str, Any]) -> None:
    print_line(json.dumps(value, indent=2, allow_nan=False))


def _command() -> str:
    return shlex.join(["hapslam", *sys.argv[1:]])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments; by default those of the process.
    """
    given = None if arguments is None else list(arguments)
    if sys.stderr.isatty():
        _tell_notes()
    try:
        status = app(args=given, prog_name="hapslam", standalone_mode=False) or 0
        sys.stdout.flush()  # a full disk or a closed pipe is told here, not when Python ends
        sys.exit(status)
    except _UsageError as error:
        path = error.ctx.command_path if error.ctx else "hapslam"
        text = " ".join(error.format_message().split())
        if not text:  # a command that needs others has shown its help
            sys.exit(2)
        sys.stderr.write(f"{path}: error: {text} ({path} --help tells more)\n")
        sys.exit(2)
    except typer.Abort:
        sys.stderr.write("hapslam: interrupted\n")
        sys.exit(130)
    except (HapslamError, OSError) as error:
        text = "; ".join([str(error), *getattr(error, "__notes__", [])])
        sys.stderr.write(f"hapslam: error: {' '.join(text.split())}\n")
        _drop_output()
        sys.exit(2)


def _tell_notes() -> None:
    """Print what the packages note by the way, as that functions are compiled, where somebody watches."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("hapslam: note: %(message)s"))
    logger = logging.getLogger("hapslam")
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)


def _drop_output() -> None:
    """Forget what the standard output could not take: Python would try again, and fail, on its way out."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
