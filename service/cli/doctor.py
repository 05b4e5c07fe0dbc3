"""What `hapslam doctor` looks at: the ray tracer, the machine, the database library."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterable
from typing import Any, Protocol

from rich.console import Console
from rich.table import Table
from rich.text import Text

__all__ = ["Finding", "as_json", "machine_findings", "print_findings"]

_SQLITE = (3, 35)


class Finding(Protocol):
    """One thing that was looked at; :class:`raytrace.propagation.backend.Check` is one."""

    @property
    def name(self) -> str:
        """What was looked at."""

    @property
    def ok(self) -> bool:
        """Whether it will do."""

    @property
    def value(self) -> str:
        """What was found."""

    @property
    def remedy(self) -> str:
        """What helps, if it will not do."""


def machine_findings(check: type[Any]) -> list[Finding]:
    """Processors and database of this machine, each made by ``check(name, ok, value, remedy)``."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    recent = sqlite3.sqlite_version_info >= _SQLITE
    needed = ".".join(str(part) for part in _SQLITE)
    return [
        check("processors", True, str(usable), ""),
        _compiled(check),
        check(
            "database",
            recent,
            f"SQLite {sqlite3.sqlite_version}",
            "" if recent else f"use a Python built with SQLite {needed} or newer",
        ),
    ]


def _compiled(check: type[Any]) -> Any:
    """Whether the machine code of the estimator is kept from one process to the next, and where."""
    import estimator.slam.models.kalman  # one of the rooms with compiled functions
    from estimator.compiled import cache_folder

    assert estimator.slam.models.kalman is not None
    folder = cache_folder()
    remedy = "set NUMBA_CACHE_DIR to a folder that may be written" if folder is None else ""
    value = "kept nowhere: every process compiles" if folder is None else f"kept in {folder}"
    return check("compiled functions", folder is not None, value, remedy)


def as_json(findings: Iterable[Finding]) -> dict[str, Any]:
    """The findings as JSON types: ``ok`` of all, and ``checks`` one by one."""
    checks = [{"name": f.name, "ok": f.ok, "value": f.value, "remedy": f.remedy} for f in findings]
    return {"ok": all(check["ok"] for check in checks), "checks": checks}


def print_findings(findings: Iterable[Finding], console: Console) -> None:
    """Print the findings as a table, remedies below what they mend."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        verdict = Text("ok", "green") if finding.ok else Text("BAD", "red")
        table.add_row(verdict, Text(finding.name), Text(finding.value))
        if not finding.ok:
            table.add_row("", "", Text.assemble(("remedy:", "bold"), f" {finding.remedy}"))
    console.print(table)
