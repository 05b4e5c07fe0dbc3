"""A server in a process of its own, on a database of its own, to be measured."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.errors import HapslamError

__all__ = ["MeasuredServer", "resident_mib", "running"]

_START_S = 30.0


@dataclass(frozen=True)
class MeasuredServer:
    """A server that runs.

    Parameters
    ----------
    port : int
        Where it listens, on loopback.
    pid : int
        Its process.
    start_s : float
        Seconds from the command to the open port.
    """

    port: int
    pid: int
    start_s: float

    def memory_mib(self) -> float:
        """Resident memory of all its processes, MiB; 0 where the system does not tell."""
        return sum(resident_mib(self.pid).values())


@contextmanager
def running(workers: int, database: str | None = None) -> Iterator[MeasuredServer]:
    """A server, stopped afterwards.

    Parameters
    ----------
    workers : int
        Processes that step sessions.
    database : str, optional
        URL of the database; by default a SQLite file in a temporary folder.

    Raises
    ------
    HapslamError
        If the server does not start.
    """
    with TemporaryDirectory(prefix="hapslam-bench-") as folder:
        url = database or f"sqlite:///{Path(folder) / 'bench.db'}"
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
        command = [sys.executable, "-c", "from service.cli.main import main; main()", "serve"]
        options = ["--port", str(port), "--database", url, "--workers", str(workers)]
        begin = time.perf_counter()
        with (Path(folder) / "log").open("wb") as log:
            server = subprocess.Popen([*command, *options], stderr=log)
        try:
            _wait(port, server)
            yield MeasuredServer(port, server.pid, time.perf_counter() - begin)
        finally:
            server.terminate()
            server.wait(60)


def _wait(port: int, server: subprocess.Popen[bytes]) -> None:
    end = time.perf_counter() + _START_S
    while time.perf_counter() < end and server.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.02)
    raise HapslamError("expected the server to start, it did not")


def resident_mib(pid: int) -> dict[int, float]:
    """Resident memory of a process and its children, whichever thread began them, MiB by process."""
    process = Path("/proc") / str(pid)
    try:
        status = (process / "status").read_text()
        children = [child for task in (process / "task").iterdir() for child in _children(task)]
    except OSError:
        return {pid: 0.0}
    own = next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")), 0)
    found = {pid: own / 1024}
    for child in children:
        found |= resident_mib(child)
    return found


def _children(task: Path) -> list[int]:
    try:
        return [int(child) for child in (task / "children").read_text().split()]
    except OSError:  # the thread has ended
        return []
