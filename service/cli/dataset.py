"""The commands of datasets: `trace`, `campaign`, `append`, `merge`, `verify`, `info`, `export`."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from estimator.errors import ConfigurationError
from service.cli.console import made_parents, plain_console
from service.cli.missing_paths import STRICT_STATUS, Strict, tell_missing
from service.cli.progress import Reporter

__all__ = ["register"]

Scene = Annotated[str, typer.Argument(help="Name of a shipped scene, or a floor plan file.")]
Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="Dataset directory.")]
Out = Annotated[
    Path, typer.Option(metavar="DATASET", help="Dataset directory to make.", callback=made_parents)
]
Jobs = Annotated[int, typer.Option(min=1, help="Processes of this machine that make shards.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers make the shards.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]

_LAYOUTS = ("mat", "deepmimo")


def register(app: typer.Typer) -> None:
    """Add the commands of datasets to the command line."""
    for command, *examples in (
        (
            trace,
            "trace l-room --out room",
            "trace my-plan.toml --out mine --seed 7 --jobs 4 --resume",
            "trace l-room --out part2 --shard-epochs 50 --part 2/3",
            "trace office --out office --engine images",
        ),
        (campaign, "campaign rooms.toml --out rooms", "campaign rooms.toml --out rooms --jobs 4"),
        (append, "append rooms/l-room-short-seed1 --epochs 200"),
        (merge, "merge l-room part1 part2 part3 --out room"),
        (verify, "verify room", "verify room --json"),
        (info, "info room", "info room --json"),
        (export, "export room --to mat --out room-matlab", "export room --to deepmimo --out room-deepmimo"),
    ):
        app.command(epilog=_examples(*examples))(command)


def _examples(*lines: str) -> str:
    return "[bold]Examples[/]\n\n" + "\n\n".join(f"  $ hapslam {line}" for line in lines)


def trace(
    scene: Scene,
    out: Out,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all randomness.")] = 1,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with what an interrupted run left; begin if there is none."),
    ] = False,
    part: Annotated[
        str | None, typer.Option(metavar="I/N", help="Make every N-th shard only, to be merged.")
    ] = None,
    shard_epochs: Annotated[
        int, typer.Option(min=0, help="Epochs in a shard; by default 1024, fewer if they are large.")
    ] = 0,
    content: Annotated[
        str, typer.Option(help="Passive channels as frequency or impulse responses: cfr, cir or both.")
    ] = "cfr",
    licence: Annotated[str, typer.Option(help="Terms of use, for the data card.")] = "",
    engine: Annotated[
        str | None,
        typer.Option(
            help="What finds the paths, if not as the plan says: sionna, or images (needs no tracer)."
        ),
    ] = None,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Trace a floor plan and write a dataset: channels, echoes, paths, truth.

    If the plan has several agents, the folder holds a dataset of each.
    """
    from estimator.executors import open_workers
    from raytrace.dataset.agents import generate_agents
    from raytrace.dataset.generate import generate_part
    from raytrace.dataset.output import Output
    from raytrace.plan.files import load_floorplan, updated

    plan = load_floorplan(scene)
    if engine is not None:
        plan = updated(plan, {"tracing.engine": engine})
    for repair in plan.repairs.lines():
        Reporter(quiet).say(f"hapslam: note: {repair}")
    output = Output(shard_epochs, content, licence)
    made: tuple[Path, ...] = (out,)
    portion = None if part is None else _part(part)
    with open_workers(jobs, scheduler) as crew, Reporter(quiet).stage("trace") as advance:
        if portion is None:
            made = generate_agents(plan, out, seed, advance, output=output, resume=resume, crew=crew)
        else:
            generate_part(plan, out, seed, portion, advance, output=output, resume=resume, crew=crew)
    if tell_missing(made) and strict:
        raise typer.Exit(STRICT_STATUS)


def campaign(
    file: Annotated[Path, typer.Argument(help="Campaign file (TOML): scenes, seeds, set-ups.")],
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for the datasets.", callback=made_parents)
    ],
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Trace many scenes, set-ups and seeds; what was broken off goes on."""
    from estimator.executors import open_workers
    from raytrace.dataset.campaign import run_campaign

    with open_workers(jobs, scheduler) as crew, Reporter(quiet).stage("campaign") as advance:
        made = run_campaign(file, out, advance, crew)
        for dataset in made:
            _print(str(dataset))
    if tell_missing(made) and strict:
        raise typer.Exit(STRICT_STATUS)


def append(
    dataset: Dataset,
    epochs: Annotated[int, typer.Option(min=2, help="Epochs that it shall have.")],
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    quiet: Quiet = False,
) -> None:
    """Let the agent walk on along its way-points; what is there stays."""
    from estimator.executors import open_workers
    from raytrace.dataset.append import append as run

    with open_workers(jobs, scheduler) as crew, Reporter(quiet).stage("append") as advance:
        run(dataset, epochs, advance, crew)


def merge(
    scene: Scene,
    parts: Annotated[list[Path], typer.Argument(metavar="PART...", help="What `trace --part` made.")],
    out: Out,
) -> None:
    """Put parts together that were traced apart."""
    from raytrace.dataset.merge import merge as run
    from raytrace.plan.files import load_floorplan

    run(load_floorplan(scene), parts, out)


def verify(dataset: Dataset, as_json: Json = False, quiet: Quiet = False) -> None:
    """Compare the paths in the files with the image method; status 1 if one is lost or extra."""
    from estimator.dataset import open_dataset
    from raytrace.dataset.verify import verify as run

    with Reporter(quiet).stage("verify") as advance:
        result = run(open_dataset(dataset), advance)
    if as_json:
        _print(json.dumps(result.as_dict(), indent=2, allow_nan=False))
    else:
        _print(
            f"paths      {result.found} of {result.expected} found, {result.missing} missing, "
            f"{result.extra} extra, {result.wrong} wrong"
        )
        if result.found:
            _print(f"delays     within {1e3 * result.delay_error_m:.3f} mm")
            _print(f"arrivals   within {result.angle_error_deg:.4f} degrees")
            _print(f"amplitudes within {result.amplitude_error_db:.4f} dB of Fresnel theory")
        else:
            _print("delays, arrivals and amplitudes: there was nothing to compare")
        for path in result.named:
            over = " over " + ", ".join(path["surfaces"]) if path["surfaces"] else ", line of sight"
            _print(f"{path['fault']:<10} epoch {path['epoch']}, anchor {path['anchor']}{over}")
    if not result.ok:
        raise typer.Exit(1)


def info(dataset: Dataset, as_json: Json = False) -> None:
    """Tell what a dataset holds, also while it is being made; status 1 if files are damaged."""
    from estimator.inventory import inventory
    from service.cli.report import print_inventory

    facts = inventory(dataset)
    if as_json:
        _print(json.dumps(facts, indent=2, allow_nan=False))
    else:
        print_inventory(facts, plain_console())
    if facts["damaged"]:
        raise typer.Exit(1)


def export(
    dataset: Annotated[Path, typer.Argument(help="Dataset folder; of tum a result file.")],
    to: Annotated[
        str,
        typer.Option(help="mat (MATLAB, Octave) or deepmimo (a scenario's folder); tum: a result's track."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder to make; of tum a file.", callback=made_parents)
    ],
) -> None:
    """Write a dataset, or the track of a result, for other software."""
    if to == "tum":
        _export_track(dataset, out)
        return
    from estimator.dataset import open_dataset
    from raytrace.dataset.export_deepmimo import export_deepmimo
    from raytrace.dataset.export_mat import export_mat
    from raytrace.dataset.journal import require_place

    if to not in _LAYOUTS:
        raise ConfigurationError(f"--to: expected one of {', '.join(_LAYOUTS)}, tum, got {to!r}")
    opened = open_dataset(dataset)
    require_place(out)
    out.mkdir()
    (export_mat if to == "mat" else export_deepmimo)(opened, out)


def _export_track(result: Path, out: Path) -> None:
    """Write the track of a result as TUM's text, in the frame of the known anchors where they fixed it."""
    from estimator.dataset import require_absent
    from estimator.result import load_result
    from service.session.trajectories import tum_text

    require_absent(out)
    loaded = load_result(result)
    stated = loaded.settings.get("measurements", {})
    x, y = stated.get("start_m", (0.0, 0.0))
    first = float(stated.get("first_time_s", 0.0))
    places = zip(loaded.time_s.tolist(), loaded.agent_mean[:, :2].tolist(), strict=True)
    rows = ((first + t, x + place[0], y + place[1]) for t, place in places)
    out.write_text(tum_text(rows), encoding="utf-8")


def _part(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if match is None:
        raise ConfigurationError(f"--part: expected I/N, such as 2/4, got {text!r}")
    return int(match[1]), int(match[2])


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
