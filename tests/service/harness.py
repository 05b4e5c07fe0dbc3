"""Servers in processes of their own, a PostgreSQL of the test's own, and clients that never give up."""

from __future__ import annotations

import os
import pwd
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from estimator.measurements import MeasurementSet
from estimator.result import load_result
from estimator.slam import run_slam
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry

ROOT = Path(__file__).resolve().parents[2]
SEED = 4


def free_port() -> int:
    """A port that no one listens on, and that no one is given for a connection to elsewhere.

    A server that is killed must find its port free again; among the ports of outgoing connections, even
    a client that tries to reach it could have taken it.
    """
    while True:
        port = random.SystemRandom().randrange(10_000, 32_000)
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) != 0:
                return port


class Server:
    """`hapslam serve` in a process of its own."""

    def __init__(
        self, database: str, workers: int = 1, log: Path | None = None, path: Sequence[Path] = ()
    ) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._command = [
            *(sys.executable, "-c", "from service.cli.main import main; main()", "serve"),
            *("--port", str(self.port), "--database", database, "--workers", str(workers)),
        ]
        self._log = log
        self._path = os.pathsep.join(map(str, (*path, ROOT)))  # what is imported first
        self.start_s = 0.0
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, patience_s: float = 60.0) -> float:
        """Start, wait until ready, and say how many seconds that took."""
        begin = time.perf_counter()
        environment = {**os.environ, "PYTHONPATH": self._path}
        with (self._log or Path(os.devnull)).open("ab") as log:
            self.process = subprocess.Popen(self._command, env=environment, stderr=log)
        while time.perf_counter() - begin < patience_s:
            if self.process.poll() is not None:
                raise RuntimeError(f"the server ended with status {self.process.returncode}")
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    self.start_s = time.perf_counter() - begin
                    return self.start_s
            time.sleep(0.02)
        raise RuntimeError("the server did not start")

    def kill(self) -> None:
        """kill -9."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self, patience_s: float = 30.0) -> int:
        """Ask to end (SIGTERM); the exit status."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(patience_s)

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None and self.process.poll() is None:
            self.kill()


def postgres_programs() -> Path | None:
    """Folder of initdb and postgres, if PostgreSQL is installed."""
    found = [str(path.parent) for path in Path("/usr/lib/postgresql").glob("*/bin/initdb")]
    beside = shutil.which("initdb")
    places = sorted(found, reverse=True) + ([str(Path(beside).resolve().parent)] if beside else [])
    return Path(places[0]) if places else None


class Postgres:
    """A PostgreSQL cluster in a temporary folder, listening on loopback alone."""

    def __init__(self, programs: Path) -> None:
        self._programs = programs
        self._folder = Path(mkdtemp(prefix="hapslam-pg-"))
        self._port = free_port()
        self.url = f"postgresql://hapslam@127.0.0.1:{self._port}/postgres"
        self._as: list[str] = []
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root
            user = pwd.getpwnam("postgres")
            os.chown(self._folder, user.pw_uid, user.pw_gid)
            self._as = ["runuser", "-u", "postgres", "--"]
        self._run(
            "initdb", "-D", str(self._folder), "-U", "hapslam", "-A", "trust", "--no-sync", "-E", "UTF8"
        )

    def _run(self, program: str, *arguments: str) -> None:
        command = [*self._as, str(self._programs / program), *arguments]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=self._folder, timeout=120)

    def start(self) -> None:
        """Start and wait until it answers."""
        options = f"-p {self._port} -k {self._folder} -c listen_addresses=127.0.0.1 -c max_connections=200"
        self._run(
            "pg_ctl", "-D", str(self._folder), "-l", str(self._folder / "log"), "-w", "-o", options, "start"
        )

    def stop(self, mode: str = "fast") -> None:
        """Stop; ``"immediate"`` is as good as pulling the plug."""
        self._run("pg_ctl", "-D", str(self._folder), "-m", mode, "-w", "stop")

    @contextmanager
    def running(self) -> Iterator[Postgres]:
        """Run, and remove everything afterwards."""
        self.start()
        try:
            yield self
        finally:
            self.stop("immediate")
            shutil.rmtree(self._folder, ignore_errors=True)


class Uploads:
    """Clients that send the walk to sessions, one after the other, whatever happens to the servers.

    Every acknowledged epoch is noted; :meth:`check` compares with what the service has.
    """

    def __init__(self, urls: Sequence[str], walk: MeasurementSet, clients: int, seed: int) -> None:
        self._urls, self._walk, self._seed = list(urls), walk, seed
        self.acknowledged: dict[str, int] = {}
        self.errors: list[BaseException] = []
        self._enough = threading.Event()
        self._threads = [threading.Thread(target=self._guard, args=(n,)) for n in range(clients)]

    def __enter__(self) -> Uploads:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._enough.set()
        for thread in self._threads:
            thread.join()

    def _guard(self, number: int) -> None:
        try:
            self._send(random.Random(1000 * self._seed + number))
        except BaseException as error:
            self.errors.append(error)

    def _send(self, dice: random.Random) -> None:
        clients = [Client(url, attempts=100_000, patience_s=0.3, timeout_s=20.0) for url in self._urls]
        walk = self._walk
        while not self._enough.is_set():
            session = clients[0].create_session(session_entry(walk, seed=SEED))
            clients[0].post_sweep(session, sweep_entry(walk))
            done = 0
            while done < len(walk.epochs):
                first = max(0, done - dice.randrange(3))  # some are sent again
                last = min(len(walk.epochs), done + dice.randint(1, 6))
                part = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs[first:last]]
                state = dice.choice(clients).post_epochs(session, part)
                assert state["epoch"] == last - 1
                done = last
                self.acknowledged[session] = done
        for client in clients:
            client.__exit__(None, None, None)

    def await_progress(self, patience_s: float = 30.0) -> None:
        """Wait until one more request is acknowledged, however slow the machine, or patience ends."""
        before, end = sum(self.acknowledged.copy().values()), time.monotonic() + patience_s
        while time.monotonic() < end and sum(self.acknowledged.copy().values()) <= before:
            time.sleep(0.02)

    def check(self, url: str, folder: Path) -> int:
        """Compare all sessions with an undisturbed run; how many there are."""
        reference = run_slam(self._walk, seed=SEED)
        with Client(url) as client:
            for session, acknowledged in self.acknowledged.items():
                expected = client.session(session)["next_epoch"]
                assert expected >= acknowledged, f"{session}: {acknowledged} acknowledged, {expected} there"
                file = folder / f"{session}.nc"
                file.write_bytes(client.export(session))
                result = load_result(file)
                for name in ("agent_mean", "agent_covariance", "log_evidence"):
                    found, wanted = getattr(result, name), getattr(reference, name)[:expected]
                    assert np.array_equal(found, wanted), f"{session}: {name} differs"
        return len(self.acknowledged)
