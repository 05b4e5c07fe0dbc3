"""The command `bench`: what the parts cost on this machine, beside their bars and peers."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import StrEnum
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.errors import FileFormatError
from service.cli.console import plain_console

if TYPE_CHECKING:
    from service.bench.comparison import Compared, Comparison
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
        epilog="[bold]Examples[/]\n\n  $ hapslam bench --only estimator\n\n"
        "  $ hapslam bench --quick --json\n\n"
        "  $ hapslam bench --only estimator --compare before.json"
    )
    def bench(
        only: Annotated[Part | None, typer.Option(help="Measure this part alone.")] = None,
        with_service: Annotated[
            bool, typer.Option("--service", help="Load a server, too; takes a minute or more.")
        ] = False,
        quick: Annotated[bool, typer.Option("--quick", help="Fewer repetitions, rougher figures.")] = False,
        compare: Annotated[
            Path | None,
            typer.Option(
                metavar="FILE",
                help="Hold the figures against what --json printed before; end with status 1 if any is worse "
                "than noise explains.",
            ),
        ] = None,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    ) -> None:
        """Measure what the parts cost here, beside their bars and the figures of peers."""
        earlier = None if compare is None else _earlier(compare, quick)
        parts = [only] if only else [Part.estimator, Part.raytrace, *([Part.service] if with_service else [])]
        begin = time.perf_counter()
        about = {"machine": _machine(), "versions": _versions(), "time": _now(), "quick": quick}
        found: list[_Measured] = []
        rows = _kept(_rows(parts, quick), found)
        if as_json:
            list(rows)
        else:
            _print_table(about, rows)
        compared = _compared(earlier, found)
        if as_json:
            seconds = time.perf_counter() - begin
            entries = [_as_json(*one) for one in zip(found, compared, strict=True)]
            sys.stdout.write(json.dumps({**about, "seconds": seconds, "rows": entries}, indent=2) + "\n")
        elif compare is not None:
            _print_compared(compare, found, compared)
        if any(one is not None and one.beyond for one in compared):
            raise typer.Exit(1)


@dataclass(frozen=True)
class _Measured:
    """A row, its part, and what a small operation took just before it was measured."""

    part: Part
    row: Row
    operation_us: float


def _rows(parts: list[Part], quick: bool) -> Iterator[_Measured]:
    """The rows of the parts, as they are measured; parts that are not there are left out."""
    from service.bench.rows import small_operation_us

    for part in parts:
        name = f"service.bench.{part}_rows"
        if find_spec(name) is None:
            continue
        rows = import_module(name).rows(quick)
        while True:
            operation_us = small_operation_us()
            row = next(rows, None)
            if row is None:
                break
            yield _Measured(part, row, operation_us)


def _kept(rows: Iterator[_Measured], found: list[_Measured]) -> Iterator[_Measured]:
    for row in rows:
        found.append(row)
        yield row


def _earlier(file: Path, quick: bool) -> Comparison:
    from estimator.json_objects import json_object
    from service.bench.comparison import Comparison

    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(
            f"{file}: expected what `hapslam bench --json` printed, could not read it: {error}"
        ) from error
    return Comparison(json_object(text, str(file)), quick)


def _compared(earlier: Comparison | None, found: list[_Measured]) -> list[Compared | None]:
    if earlier is None:
        return [None] * len(found)
    unrest = earlier.unrest([one.operation_us for one in found])
    return [earlier.of(one.row.name, one.row.unit, one.row.value, one.operation_us, unrest) for one in found]


def _print_compared(file: Path, found: list[_Measured], compared: list[Compared | None]) -> None:
    """Print each row's ratio, and how many are worse."""
    from rich.table import Table

    console = plain_console()
    table = Table(box=None, pad_edge=False, title_justify="left")
    table.add_column("what", overflow="fold")
    table.add_column("now over before (noise band)", no_wrap=True)
    for one, ratio in zip(found, compared, strict=True):
        table.add_row(one.row.name, "not there before" if ratio is None else str(ratio))
    console.print(table)
    worse = sum(ratio is not None and ratio.beyond for ratio in compared)
    known = sum(ratio is not None for ratio in compared)
    console.print(
        f"{worse} of {known} rows worse than {file}; times in units of the small operation", soft_wrap=True
    )


def _as_json(measured: _Measured, compared: Compared | None) -> dict[str, Any]:
    row = measured.row
    told = {} if compared is None else {"compared": {**asdict(compared), "beyond": compared.beyond}}
    return {
        **told,
        "part": measured.part.value,
        "small_operation_us": measured.operation_us,
        "name": row.name,
        "value": row.value,
        "unit": row.unit,
        "bar": row.bar,
        "met": row.met,
        "peer": row.peer,
        "peer_value": row.peer_value,
        "ratio": row.ratio,
    }


def _print_table(about: dict[str, Any], rows: Iterator[_Measured]) -> None:
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
        for measured in rows:
            row = measured.row
            status.update(f"measuring: {measured.part.value}")
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
