"""The command `bench`: what the parts cost on this machine, beside their bars and peers."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from enum import StrEnum
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import plain_console

if TYPE_CHECKING:
    from service.bench.rows import Row

__all__ = ["register"]

_PACKAGES = ("hapslam", "numpy", "scipy", "sionna-rt", "mitsuba", "drjit", "fastapi", "sqlalchemy")


class Part(StrEnum):
    """What can be measured."""

    estimator = "estimator"
    raytrace = "raytrace"
    service = "service"


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""

    @app.command(
        epilog="[bold]Examples[/]\n\n  $ hapslam bench --only estimator\n\n  $ hapslam bench --quick --json"
    )
    def bench(
        only: Annotated[Part | None, typer.Option(help="Measure this part alone.")] = None,
        with_service: Annotated[
            bool, typer.Option("--service", help="Load a server, too; takes a minute or more.")
        ] = False,
        quick: Annotated[bool, typer.Option("--quick", help="Fewer repetitions, rougher figures.")] = False,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    ) -> None:
        """Measure what the parts cost here, beside their bars and the figures of peers."""
        parts = [only] if only else [Part.estimator, Part.raytrace, *([Part.service] if with_service else [])]
        begin = time.perf_counter()
        about = {"machine": _machine(), "versions": _versions(), "time": _now(), "quick": quick}
        if as_json:
            rows = [_as_json(part, row) for part, row in _rows(parts, quick)]
            seconds = time.perf_counter() - begin
            sys.stdout.write(json.dumps({**about, "seconds": seconds, "rows": rows}, indent=2) + "\n")
        else:
            _print_table(about, _rows(parts, quick))


def _rows(parts: list[Part], quick: bool) -> Iterator[tuple[Part, Row]]:
    """The rows of the parts, as they are measured; parts that are not there are left out."""
    for part in parts:
        name = f"service.bench.{part}_rows"
        if find_spec(name) is not None:
            for row in import_module(name).rows(quick):
                yield part, row


def _as_json(part: Part, row: Row) -> dict[str, Any]:
    return {
        "part": part.value,
        "name": row.name,
        "value": row.value,
        "unit": row.unit,
        "bar": row.bar,
        "met": row.met,
        "peer": row.peer,
        "peer_value": row.peer_value,
        "ratio": row.ratio,
    }


def _print_table(about: dict[str, Any], rows: Iterator[tuple[Part, Row]]) -> None:
    from rich.table import Table
    from rich.text import Text

    console = plain_console()
    machine = about["machine"]
    console.print(
        f"{about['time']}: {machine['cpu']}, {machine['cores']} cores; {machine['system']}; "
        f"a small NumPy operation takes {machine['small_operation_us']:.2f} us",
        highlight=False,
    )
    console.print(
        ", ".join(f"{name} {version}" for name, version in about["versions"].items()), highlight=False
    )
    table = Table(box=None, pad_edge=False, title_justify="left")
    table.add_column("what", overflow="fold")
    for heading in ("here", "bar"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("peer", overflow="fold")
    with console.status("measuring") as status:
        for part, row in rows:
            status.update(f"measuring: {part.value}")
            verdict = {None: Text(""), True: Text(" met", "green"), False: Text(" NOT met", "red")}[row.met]
            bar = Text("") if row.bar is None else Text(f"{row.bar:.3g} {row.unit}") + verdict
            peer = ""
            if row.peer is not None and row.peer_value is not None:
                peer = f"{row.peer}: {row.peer_value:.3g} {row.unit} (x {row.ratio:.2g})"
            table.add_row(row.name, f"{row.value:.3g} {row.unit}", bar, peer)
    console.print(table)


def _machine() -> dict[str, Any]:
    from estimator.executors import available_cores
    from service.bench.rows import small_operation_us

    return {
        "cpu": _cpu(),
        "cores": available_cores(),
        "system": platform.platform(terse=True),
        "small_operation_us": small_operation_us(),
    }


def _cpu() -> str:
    """The processor's name, as well as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def _versions() -> dict[str, str]:
    from importlib import metadata

    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
