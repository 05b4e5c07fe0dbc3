"""Asks a server whether it lives, and looks at its memory, from a process that does nothing else.

    python -m tests.service.watcher URL PID

until its input ends; then it prints what it saw, as JSON. Beside the server it asks a process that only
answers, for a machine that is busy with other things lets that one wait as well.
"""

from __future__ import annotations

import json
import multiprocessing
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

import httpx2

from service.bench.server import resident_mib
from tests.service.harness import ROOT, Server

__all__ = ["Seen", "Watcher"]

_EVERY_S = 0.05
_WEIGH_EVERY = 4  # questions


@dataclass(frozen=True)
class Seen:
    """What a watcher saw.

    Parameters
    ----------
    waits_s : list of float
        How long the server took to say that it lives, each time.
    idle_waits_s : list of float
        How long a process took that does nothing else than to answer.
    most_mib : float
        Memory of the server's largest process.
    """

    waits_s: list[float]
    idle_waits_s: list[float]
    most_mib: float


class Watcher:
    """A watcher of a server, as a context; `seen` is there when it ends."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self.seen = Seen([], [], 0.0)

    def __enter__(self) -> Watcher:
        assert self._server.process is not None
        command = [sys.executable, "-m", "tests.service.watcher", self._server.url]
        command.append(str(self._server.process.pid))
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "begun\n"
        return self

    def __exit__(self, *_: object) -> None:
        told, _ = self._process.communicate(timeout=60)
        self.seen = Seen(**json.loads(told))


def _echo(connection: Connection) -> None:
    while connection.recv():
        connection.send(True)


def _watch(url: str, pid: int) -> Seen:
    mine, theirs = multiprocessing.Pipe()
    idle = multiprocessing.Process(target=_echo, args=(theirs,), daemon=True)
    idle.start()
    waits, idle_waits, most = list[float](), list[float](), 0.0
    with httpx2.Client(base_url=url, timeout=60.0) as client:
        sys.stdout.write("begun\n")
        sys.stdout.flush()
        while not select.select([sys.stdin], [], [], _EVERY_S)[0]:
            begin = time.perf_counter()
            mine.send(True)
            mine.recv()
            between = time.perf_counter()
            assert client.get("/livez").status_code == 200
            waits.append(time.perf_counter() - between)
            idle_waits.append(between - begin)
            if len(waits) % _WEIGH_EVERY == 0:
                most = max(most, *resident_mib(pid).values())
    idle.kill()
    return Seen(waits, idle_waits, most)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(vars(_watch(sys.argv[1], int(sys.argv[2])))) + "\n")
