"""The processes that step sessions: how many may wait, how long a task may take, what a crash costs."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.errors import BusyError, StepTimeoutError, WorkerDiedError
from service.fold import Folded, Job, StateCache
from service.settings import load_settings
from service.workers import StepPool


@dataclass(frozen=True)
class Nap:
    """Takes its time, and says in which process."""

    seconds: float

    def run(self, cache: StateCache) -> int:
        """Sleep."""
        del cache
        time.sleep(self.seconds)
        return os.getpid()


@dataclass(frozen=True)
class Crash:
    """Takes its process along."""

    def run(self, cache: StateCache) -> int:
        """End the process."""
        del cache
        os._exit(3)


def test_as_many_wait_as_may() -> None:
    """One in work and one that waits; a third is refused at once, and served when both are done."""
    with StepPool(workers=1, max_waiting=1, timeout_s=30.0) as pool:
        worker = pool.run("a", Nap(0.0))
        assert worker != os.getpid()
        threads = [threading.Thread(target=pool.run, args=("a", Nap(0.6))) for _ in range(2)]
        for thread in threads:
            thread.start()
        while pool.waiting < 2:
            time.sleep(0.01)
        begin = time.perf_counter()
        with pytest.raises(BusyError, match="expected a free worker, 2 requests wait already"):
            pool.run("b", Nap(0.0))
        assert time.perf_counter() - begin < 0.5
        for thread in threads:
            thread.join()
        assert pool.run("b", Nap(0.0)) == worker
        assert pool.waiting == 0


def test_what_takes_too_long_or_crashes_is_replaced() -> None:
    """A task past its time and one that ends the process are told of; the next finds a new worker."""
    with StepPool(workers=1, max_waiting=1, timeout_s=5.0) as pool:
        first = pool.run("a", Nap(0.0))
        with pytest.raises(StepTimeoutError, match="at most 5 s"):
            pool.run("a", Nap(60.0))
        second = pool.run("a", Nap(0.0))
        with pytest.raises(WorkerDiedError, match="nothing was taken in"):
            pool.run("a", Crash())
        assert len({first, second, pool.run("a", Nap(0.0))}) == 3


def test_an_answer_comes_in_time(
    database: str,
    make_request: Callable[..., Any],
    sweep_request: Callable[..., Any],
    epochs_request: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the work takes longer than a request may, 504 at that time; the same again is fine later."""
    settings = load_settings(database_url=database, workers=0, request_timeout_s=1.0)
    fold = StepPool.fold

    def slow(self: StepPool, job: Job) -> Folded:
        time.sleep(2.0)
        return fold(self, job)

    with TestClient(create_app(settings), base_url="http://localhost", client=("127.0.0.1", 5000)) as client:
        url = client.post("/v1/sessions", json=make_request()).headers["Location"]
        client.post(f"{url}/sweeps", json=sweep_request())
        with monkeypatch.context() as patch:
            patch.setattr(StepPool, "fold", slow)
            begin = time.perf_counter()
            late = client.post(f"{url}/epochs", json=epochs_request(0, 3))
            assert time.perf_counter() - begin < 1.9
        assert (late.status_code, late.headers["Retry-After"]) == (504, "1")
        assert late.json()["detail"].startswith("expected an answer within 1 s")
        end = time.monotonic() + 30.0
        while client.get(url).json()["next_epoch"] < 3 and time.monotonic() < end:
            time.sleep(0.1)
        again = client.post(f"{url}/epochs", json=epochs_request(0, 3))
        assert (again.status_code, again.headers["X-New-Entries"]) == (200, "0")
