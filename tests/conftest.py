"""What holds for every test, and runs of the command line."""

from __future__ import annotations

import fcntl
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse tests that do not say what they are for; the estimator, which is compiled first, comes first.

    Tests with servers wait for answers so long, and no longer.
    """
    tests = [item for item in items if isinstance(item, pytest.Function)]
    mute = sorted({test.nodeid.split("[")[0] for test in tests if not test.function.__doc__})
    if mute:
        raise pytest.UsageError("expected a docstring in every test, missing in:\n  " + "\n  ".join(mute))
    items.sort(key=lambda item: item.path.is_relative_to(ROOT / "tests" / "browser"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what long tests measured (``record_property``), beside whether it sufficed."""
    reports = [*terminalreporter.getreports("passed"), *terminalreporter.getreports("failed")]
    told = [report for report in reports if report.when == "call" and report.user_properties]
    if told:
        terminalreporter.section("measured")
    for report in told:
        terminalreporter.line(report.nodeid)
        for name, value in report.user_properties:
            terminalreporter.line(f"    {name}: {value}")


@dataclass(frozen=True)
class Run:
    """What a command printed and how it ended."""

    status: int
    out: str
    err: str


Once = Callable[[str, Callable[[Path], Any]], tuple[Path, Any]]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Makes what is costly once for all workers of the run: a folder, and what its maker returned.

    Whoever asks first makes it, the others wait and read it; nobody may change it.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def get(name: str, make: Callable[[Path], Any]) -> tuple[Path, Any]:
        folder, returned = shared / "once" / name, shared / "once" / f"{name}.pickle"
        folder.parent.mkdir(exist_ok=True)
        with (shared / "once" / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not returned.exists():
                shutil.rmtree(folder, ignore_errors=True)  # half made, by a maker that failed
                folder.mkdir()
                returned.write_bytes(pickle.dumps(make(folder)))
        return folder, pickle.loads(returned.read_bytes())

    return get


@pytest.fixture(scope="session")
def hapslam() -> Callable[..., Run]:
    """Runs ``hapslam ARGUMENTS`` in a process of its own, as a user does."""

    def run(*arguments: object, cwd: Path | None = None, **environment: str) -> Run:
        done = subprocess.run(
            [sys.executable, "-c", "from service.cli.main import main; main()", *map(str, arguments)],
            cwd=cwd,
            env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
            capture_output=True,
            text=True,
            timeout=900,  # compiling included, on a busy machine
            check=False,
        )
        return Run(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def demo(hapslam: Callable[..., Run], once: Once) -> tuple[Path, Run]:
    """The folder of `hapslam demo --seed 1 --json`, and what it printed."""

    def make(folder: Path) -> Run:
        return hapslam("demo", "--seed", 1, "--out", folder / "out", "--json")

    folder, run = once("demo", make)
    assert run.status == 0, run.err
    return folder / "out", run


@pytest.fixture
def main(capfd: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Runs ``hapslam ARGUMENTS`` in this process: fast, for commands that do not trace."""
    from service.cli.main import main as entry

    def run(*arguments: object) -> Run:
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            entry([str(argument) for argument in arguments])
        printed = capfd.readouterr()
        return Run(int(ended.value.code or 0), printed.out, printed.err)

    return run
