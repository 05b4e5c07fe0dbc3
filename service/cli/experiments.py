"""The commands of experiments: `simulate`, `reproduce`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.errors import ConfigurationError
from estimator.experiments.catalogue import FIGURES

if TYPE_CHECKING:
    from estimator.experiments.room import Room
    from service.cli.progress import Reporter

__all__ = ["register"]

RoomLoader = Callable[[str], "Room"]

Scene = Annotated[str, typer.Argument(help="Name of a shipped scene, or a floor plan file.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all randomness; run i has seed + i.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]


def register(app: typer.Typer, load_room: RoomLoader) -> None:
    """Add the commands; ``load_room`` makes the room of a scene, for it takes the floor plan's reader."""

    @app.command(epilog=_examples("simulate l-room --out sim.nc", "simulate l-room --with aoa --out sim.nc"))
    def simulate(
        scene: Scene,
        out: Annotated[Path, typer.Option(metavar="MEASUREMENTS", help="Measurement file to write.")],
        seed: Seed = 1,
        options: Annotated[
            list[str] | None,
            typer.Option(
                "--with", metavar="OPTION", help="Measured in addition, or unknown: aoa, sweeps, clock, tdoa."
            ),
        ] = None,
        know_anchors: Annotated[
            bool, typer.Option("--know-anchors", help="Say where the anchors are, as va and mva need it.")
        ] = False,
    ) -> None:
        """Simulate measurements from geometry alone: noisy, thinned and cluttered paths, sensed walls."""
        from estimator.dataset import require_absent
        from estimator.experiments.cases import simulation_with
        from estimator.measurement_files import save_measurements

        require_absent(out)
        config = simulation_with(options or ())
        save_measurements(load_room(scene).measure(config, seed, know_anchors), out)

    @app.command(
        epilog=_examples(
            "reproduce fig13 --runs 100 --out figures --json",
            "reproduce fig13 --methods hybrid,hybrid+aoa --engine gaussian --out figures",
            "reproduce all --out figures",
            "reproduce measured --data measured --json",
            "reproduce leakage --runs 20 --json",
            "reproduce buildings --runs 4 --sweep-every 10 --odometry --out buildings --json",
        )
    )
    def reproduce(
        figure: Annotated[
            str, typer.Argument(help=f"{', '.join(FIGURES)}, all, measured, buildings, or leakage.")
        ],
        out: Annotated[
            Path | None, typer.Option(metavar="DIR", help="Folder for pictures, numbers and reports.")
        ] = None,
        data: Annotated[
            Path | None, typer.Option(metavar="FOLDER", help="Of measured: where the measured sets lie.")
        ] = None,
        runs: Annotated[
            int | None,
            typer.Option(
                min=1, help="Monte-Carlo runs; by default as many as the paper's. Of buildings: of each kind."
            ),
        ] = None,
        seed: Seed = 1,
        methods: Annotated[
            str, typer.Option(metavar="LIST", help="METHOD[+OPTION...], comma-separated; options as --with.")
        ] = "",
        engine: Annotated[
            str | None, typer.Option(help="How inference is done; by default every way there is.")
        ] = None,
        particles: Annotated[int, typer.Option(min=1, help="Particles of the particle engine.")] = 100_000,
        scene: Annotated[str, typer.Option(help="Scene of the SLAM experiments.")] = "l-room",
        jobs: Annotated[
            int | None, typer.Option(min=1, help="Local processes; by default one for each core.")
        ] = None,
        scheduler: Annotated[
            str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, instead of local processes.")
        ] = None,
        kinds: Annotated[
            str, typer.Option(metavar="LIST", help="Of buildings: kinds of random plans, comma-separated.")
        ] = "",
        sweep_every: Annotated[
            int, typer.Option(min=0, help="Of buildings: epochs between sweeps; 0 for one at the start.")
        ] = 1,
        odometry: Annotated[
            bool, typer.Option("--odometry", help="Of buildings: with odometry (5 % and 1 degree a step).")
        ] = False,
        aoa: Annotated[
            bool, typer.Option("--aoa", help="Of buildings: with directions of arrival (4 by 4 antennas).")
        ] = False,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
        quiet: Quiet = False,
    ) -> None:
        """Recompute figures of the paper: picture, numbers, and a report beside its values and the limit.

        With `measured`, SLAM on measured sets of others beside plain methods; with `buildings`, random
        buildings traced, mapped and scored: with all that is sensed, by echoes alone, by paths alone;
        with `leakage`, the share of walls that echoes find over distance and isolation.
        """
        if figure == "measured":
            _measured(data, methods, as_json)
            return
        if figure == "leakage":
            if out is not None or methods or engine:
                raise ConfigurationError("out, methods, engine: expected none for leakage")
            _leakage(runs or 20, seed, jobs, as_json, quiet)
            return
        sensing = {"sweep_every": sweep_every, "odometry": odometry, "aoa": aoa}
        if figure != "buildings" and (
            kinds or sensing != {"sweep_every": 1, "odometry": False, "aoa": False}
        ):
            raise ConfigurationError(
                f"--kinds, --sweep-every, --odometry, --aoa: expected with buildings, got {figure}"
            )
        if out is None:
            raise ConfigurationError("--out: expected a folder for pictures, numbers and reports, got none")
        from estimator.executors import available_cores, open_workers
        from estimator.experiments import catalogue
        from estimator.experiments.report import as_text, require_places, write_report
        from service.cli.progress import Reporter

        if figure == "buildings":
            if methods or engine:
                raise ConfigurationError("methods, engine: expected none for buildings")
            _buildings(
                out, kinds, runs or 1, seed, sensing, jobs or available_cores(), as_json, Reporter(quiet)
            )
            return
        names = catalogue.wanted(figure)
        require_places(out, names)
        chosen = [name.strip() for name in methods.split(",") if name.strip()]
        room, reporter = load_room(scene), Reporter(quiet)
        summaries: dict[str, Any] = {}
        processes = jobs or (available_cores() if scheduler is None else 1)
        with open_workers(processes, scheduler) as workers:
            for name in names:
                slam = figure != "all" or bool(FIGURES[name].methods)  # of all, some run no SLAM
                with reporter.stage(name) as advance:
                    request = catalogue.Request(
                        room,
                        runs,
                        seed,
                        chosen if slam else (),
                        engine if slam else None,
                        particles,
                        workers,
                        advance,
                    )
                    report = catalogue.reproduce(name, request)
                    write_report(report, out)
                summaries[name] = dict(report.summary)
                if not as_json:
                    sys.stdout.write(as_text(report) + "\n")
        if as_json:
            printed = summaries if figure == "all" else summaries[figure]
            sys.stdout.write(json.dumps(printed, indent=2, allow_nan=False) + "\n")


def _buildings(
    out: Path,
    kinds: str,
    runs: int,
    seed: int,
    sensing: Mapping[str, Any],
    jobs: int,
    as_json: bool,
    reporter: Reporter,
) -> None:
    """Trace, map and score random buildings, ``runs`` of each kind."""
    from estimator.executors import open_workers
    from estimator.experiments.report import as_text, require_places, write_report
    from service.cli.buildings import Building, map_buildings, wanted_kinds

    require_places(out, ["buildings"])
    buildings = [Building(kind, i, seed, **sensing) for kind in wanted_kinds(kinds) for i in range(runs)]
    with open_workers(jobs) as workers, reporter.stage("buildings") as advance:
        report = map_buildings(buildings, workers, advance)
        write_report(report, out)
    printed = json.dumps(dict(report.summary), indent=2, allow_nan=False) if as_json else as_text(report)
    sys.stdout.write(printed + "\n")


def _leakage(draws: int, seed: int, jobs: int | None, as_json: bool, quiet: bool) -> None:
    """Share of walls found over distance and isolation of the transmitter."""
    from estimator.executors import available_cores, open_workers
    from service.cli.leakage import leakage_table, leakage_text
    from service.cli.progress import Reporter

    with open_workers(jobs or available_cores()) as workers, Reporter(quiet).stage("leakage") as advance:
        table = leakage_table(draws, seed, workers, advance)
    sys.stdout.write(json.dumps(table, indent=2) + "\n" if as_json else leakage_text(table))


def _measured(folder: Path | None, methods: str, as_json: bool) -> None:
    """Compare SLAM and plain methods on the measured sets of a folder."""
    from estimator.experiments.measured.comparison import METHOD, compare, measured_table

    if folder is None:
        raise ConfigurationError("--data: expected the folder of the measured sets, got none")
    found = compare(folder, methods or METHOD)
    printed = json.dumps(found, indent=2, allow_nan=False) + "\n" if as_json else measured_table(found)
    sys.stdout.write(printed)


def _examples(*lines: str) -> str:
    return "[bold]Examples[/]\n\n" + "\n\n".join(f"  $ hapslam {line}" for line in lines)
