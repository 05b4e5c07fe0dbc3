"""What is acknowledged is kept, once and exactly, whatever happens to processes and disks."""

from __future__ import annotations

import hashlib
import os
import random
import re
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from service.api.app import create_app
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from service.session.verify import verify
from service.settings import load_settings
from service.storage.database import opened
from service.storage.store import Store
from tests.service.harness import SEED, Postgres, Server, Uploads, postgres_programs

KILLS = int(os.environ.get("HAPSLAM_TEST_KILLS", "2"))

RESTARTS = int(os.environ.get("HAPSLAM_TEST_RESTARTS", "2"))


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL of our own; without one, skipped here, failed in CI."""
    programs = postgres_programs()
    if programs is None:
        if os.environ.get("CI"):
            pytest.fail("expected PostgreSQL to be installed in CI (apt-get install postgresql)")
        pytest.skip("PostgreSQL is not installed")
    with Postgres(programs).running() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def either_database(request: pytest.FixtureRequest, database: str) -> str:
    """Each kind of database in turn."""
    if request.param == "sqlite":
        return database
    server: Postgres = request.getfixturevalue("postgres")
    return server.url


def _app(database: str, **settings: Any) -> TestClient:
    app = create_app(load_settings(database_url=database, workers=0, **settings))
    return TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000))


def _differences(database: str) -> list[str]:
    with opened(load_settings(database_url=database).url, 5.0) as engine:
        return [text for finding in verify(Store(engine)) for text in finding.differences]


def test_two_processes_share_a_database(
    either_database: str, walk: MeasurementSet, reference: SlamResult
) -> None:
    """Two applications given the same epochs by four clients at once: each is applied once, exactly."""
    with _app(either_database) as one, _app(either_database) as two:
        url = one.post("/v1/sessions", json=session_entry(walk, seed=SEED)).headers["Location"]
        two.post(f"{url}/sweeps", json=sweep_entry(walk))
        entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs[:24]]
        answers: list[tuple[int, int]] = []

        def send(client: TestClient, seed: int) -> None:
            dice = random.Random(seed)
            done = 0
            while done < 24:
                last = min(24, done + dice.randint(1, 4))
                answer = client.post(f"{url}/epochs", json={"epochs": entries[done:last]})
                answers.append((answer.status_code, int(answer.headers.get("X-New-Entries", 0))))
                done = last

        threads = [threading.Thread(target=send, args=((one, two)[n % 2], n)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert {status for status, _ in answers} == {200}
        assert sum(new for _, new in answers) == 24
        track = two.get(f"{url}/trajectory").json()
        assert track["x_m"] == reference.agent_mean[:24, 0].tolist()
    assert _differences(either_database) == []


def test_killed_again_and_again(either_database: str, walk: MeasurementSet, tmp_path: Path) -> None:
    """kill -9 at random moments of four uploads: nothing lost, nothing twice, the same states.

    On PostgreSQL two servers share the database and the sessions.
    """
    dice = random.Random(KILLS)
    servers = [Server(either_database) for _ in range(2 if "postgresql" in either_database else 1)]
    try:
        for server in servers:
            server.start()
        with Uploads([server.url for server in servers], walk, clients=4, seed=KILLS) as uploads:
            for _ in range(KILLS):
                if dice.random() < 0.5:  # half of the kills come while epochs are flowing
                    uploads.await_progress()
                time.sleep(dice.uniform(0.0, 1.0))
                server = dice.choice(servers)
                server.kill()
                server.start()
            time.sleep(0.5)
        assert uploads.errors == []
        assert uploads.check(servers[0].url, tmp_path) >= 4
        assert [server.stop() for server in servers] == [0] * len(servers)
    finally:
        for server in servers:
            server.__exit__()
    assert _differences(either_database) == []


def test_a_restarted_database_loses_nothing(postgres: Postgres, walk: MeasurementSet, tmp_path: Path) -> None:
    """Two servers on one PostgreSQL that is stopped hard and started again during uploads."""
    with Server(postgres.url) as one, Server(postgres.url) as two:
        with Uploads([one.url, two.url], walk, clients=2, seed=1) as uploads:
            for _ in range(RESTARTS):
                time.sleep(0.7)
                postgres.stop("immediate")
                time.sleep(0.2)
                postgres.start()
            time.sleep(0.7)
        assert uploads.errors == []
        uploads.check(one.url, tmp_path)
    assert _differences(postgres.url) == []


def test_the_server_drains_on_sigterm(database: str, walk: MeasurementSet) -> None:
    """A request in work when SIGTERM comes is finished and acknowledged; open streams end; status 0."""
    with Server(database) as server, Client(server.url) as client:
        session = client.create_session(session_entry(walk, seed=SEED))
        client.post_sweep(session, sweep_entry(walk))
        entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs]
        ready = client.create_session(session_entry(walk, seed=SEED))  # its steps wait for the workers' start
        client.post_sweep(ready, sweep_entry(walk))
        client.post_epochs(ready, entries)
        told: list[int] = []

        def follow() -> None:
            with Client(server.url, attempts=1) as follower:
                try:
                    told.extend(state["epoch"] for state in follower.events(session))
                except Exception:  # the server has gone
                    return

        follower = threading.Thread(target=follow)
        follower.start()
        sender_state: dict[str, Any] = {}
        sender = threading.Thread(target=lambda: sender_state.update(client.post_epochs(session, entries)))
        sender.start()
        time.sleep(0.15)
        assert server.stop() == 0
        sender.join(30)
        follower.join(30)
        assert not sender.is_alive()
        assert not follower.is_alive()
        assert sender_state.get("epoch") == 39


def test_workers_die_with_the_server(database: str, walk: MeasurementSet) -> None:
    """After kill -9 no worker process is left behind, and a new server takes up the work."""
    with Server(database, workers=2) as server, Client(server.url) as client:
        client.create_session(session_entry(walk))
        assert server.process is not None
        children = _descendants(server.process.pid)
        assert len(children) >= 2
        server.kill()
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline and any(Path(f"/proc/{child}").exists() for child in children):
            time.sleep(0.1)
        assert not any(Path(f"/proc/{child}").exists() for child in children)


def _descendants(pid: int) -> list[int]:
    children = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            children += [int(child), *_descendants(int(child))]
    return children


@pytest.mark.parametrize("damage", ["changed", "rewritten", "missing"])
def test_a_damaged_snapshot_is_rebuilt_from_the_log(
    database: str, walk: MeasurementSet, reference: SlamResult, damage: str
) -> None:
    """Bytes changed, bytes replaced with a fitting digest, no snapshot: the next epoch comes right."""
    entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs]
    with _app(database) as client:
        url = client.post("/v1/sessions", json=session_entry(walk, seed=SEED)).headers["Location"]
        client.post(f"{url}/sweeps", json=sweep_entry(walk))
        client.post(f"{url}/epochs", json={"epochs": entries[:10]})
    with sqlite3.connect(database.removeprefix("sqlite:///")) as raw:
        if damage == "changed":
            raw.execute("UPDATE snapshots SET state = substr(state, 1, 500)")
        elif damage == "rewritten":
            rubbish = b"rubbish"
            raw.execute(
                "UPDATE snapshots SET state = ?, sha256 = ?", (rubbish, hashlib.sha256(rubbish).digest())
            )
        else:
            raw.execute("DELETE FROM snapshots")
    assert _differences(database) == ["the snapshot differs"]
    with _app(database) as client:
        assert client.post(f"{url}/epochs", json={"epochs": entries[10:20]}).status_code == 200
        track = client.get(f"{url}/trajectory").json()
    assert np.array_equal(track["x_m"], reference.agent_mean[:20, 0])
    assert _differences(database) == []


def test_verification_sees_a_changed_log(database: str, walk: MeasurementSet) -> None:
    """A digit of the log changed behind the service's back is found, with the epoch where it begins."""
    entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs[:10]]
    with _app(database) as client:
        url = client.post("/v1/sessions", json=session_entry(walk, seed=SEED)).headers["Location"]
        client.post(f"{url}/sweeps", json=sweep_entry(walk))
        client.post(f"{url}/epochs", json={"epochs": entries})
    with sqlite3.connect(database.removeprefix("sqlite:///")) as raw:
        raw.execute(
            "UPDATE measurements SET body = replace(body, '\"time_s\":6.0', '\"time_s\":6.25') "
            "WHERE kind = 'epoch' AND number = 6"
        )
    assert "the estimates differ from epoch 6 on" in _differences(database)


def test_a_full_disk_a_lock_and_a_read_only_database(
    database: str, walk: MeasurementSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each has its own clear answer, nothing is taken in, and all is well once it has passed."""
    entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs]
    path = database.removeprefix("sqlite:///")
    with _app(database, lock_timeout_s=0.3) as client:
        url = client.post("/v1/sessions", json=session_entry(walk, seed=SEED)).headers["Location"]
        client.post(f"{url}/sweeps", json=sweep_entry(walk))
        engine: sa.Engine = client.app.state.context.store.engine  # type: ignore[attr-defined]

        locker = sqlite3.connect(path, isolation_level=None)
        locker.execute("BEGIN IMMEDIATE")
        locked = client.post(f"{url}/epochs", json={"epochs": entries[:5]})
        assert (locked.status_code, locked.json()["type"]) == (503, "urn:hapslam:problem:locked")
        assert client.get(url).json()["next_epoch"] == 0  # reading goes on
        locker.execute("ROLLBACK")
        assert client.post(f"{url}/epochs", json={"epochs": entries[:5]}).status_code == 200

        with _Pragmas(engine, "query_only=1"):
            answer = client.post(f"{url}/epochs", json={"epochs": entries[5:10]})
            assert (answer.status_code, answer.json()["type"]) == (503, "urn:hapslam:problem:read-only")
        pages = locker.execute("PRAGMA page_count").fetchone()[0]
        with _Pragmas(engine, f"max_page_count={pages}"):
            statuses = []
            for first in range(5, 40, 5):
                answer = client.post(f"{url}/epochs", json={"epochs": entries[first : first + 5]})
                statuses.append(answer.status_code)
                if answer.status_code != 200:
                    break
            assert (answer.status_code, answer.json()["type"]) == (507, "urn:hapslam:problem:disk-full")
        done = client.get(url).json()["next_epoch"]
        assert client.post(f"{url}/epochs", json={"epochs": entries[done:]}).status_code == 200
    assert _differences(database) == []


class _Pragmas:
    """Set a pragma on every connection that the application makes meanwhile."""

    def __init__(self, engine: sa.Engine, pragma: str) -> None:
        self._engine, self._pragma = engine, pragma

    def _set(self, connection: Any, _: object) -> None:
        connection.execute(f"PRAGMA {self._pragma}")

    def __enter__(self) -> None:
        self._engine.dispose()
        sa.event.listen(self._engine, "connect", self._set)

    def __exit__(self, *_: object) -> None:
        sa.event.remove(self._engine, "connect", self._set)
        self._engine.dispose()


def test_events_reach_a_client_of_another_process(
    either_database: str, walk: MeasurementSet, make_request: Callable[..., Any]
) -> None:
    """Epochs taken in by one process are told by the other, from the database."""
    with _app(either_database) as one, Server(either_database) as two, Client(two.url) as client:
        url = one.post("/v1/sessions", json=session_entry(walk, seed=SEED)).headers["Location"]
        one.post(f"{url}/sweeps", json=sweep_entry(walk))
        entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs[:6]]
        told = []
        stream = client.events(url.rsplit("/", 1)[1])
        for first in range(0, 6, 2):
            assert one.post(f"{url}/epochs", json={"epochs": entries[first : first + 2]}).status_code == 200
            told += [next(stream)["epoch"], next(stream)["epoch"]]
        assert told == list(range(6))
        for process in (f"http://localhost{url}", f"{two.url}{url}"):  # a client that comes back, to either
            get = one.get if process.startswith("http://localhost/") else httpx2.get
            back = get(f"{process}/events?follow=false", headers={"Last-Event-ID": "3"})
            assert re.findall(r"^id: (\d+)$", back.text, re.MULTILINE) == ["4", "5"]
        assert one.delete(url).status_code == 204
        assert list(stream) == []
