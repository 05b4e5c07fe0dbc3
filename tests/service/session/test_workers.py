"""The processes that do the work: how long a task may take, how much memory, what a crash costs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from estimator.errors import InputError
from service.api.app import create_app
from service.errors import StepTooLargeError, StepTooLongError, WorkerDiedError
from service.session.fold import Job
from service.session.tasks import WorkerSetup
from service.session.worker import LocalWorker, Worker
from service.settings import load_settings
from service.storage.folded import Folded
from tests.service.tasks import Crash, Hoard, Nap, Spin, Stumble


@pytest.fixture
def worker() -> Iterator[Worker]:
    """A process with 300 MiB, five seconds for a task and one of them for a step."""
    worker = Worker(WorkerSetup(most_bytes=300 * 2**20, step_limit_s=1.0, task_limit_s=5.0))
    worker.start()
    try:
        yield worker
    finally:
        worker.stop()


def test_what_exceeds_a_limit_is_replaced(worker: Worker) -> None:
    """Too long, too large, a crash: each is told for what it is, and the next finds a new process."""
    seen = {worker.do(Nap(0.0))}
    with pytest.raises(StepTooLongError, match="work of at most 5 s"):
        worker.do(Nap(60.0))
    seen.add(worker.do(Nap(0.0)))
    with pytest.raises(StepTooLongError, match=r"epoch 7 .*90 paths.: expected a step of at most 1 s"):
        worker.do(Spin(60.0))
    seen.add(worker.do(Nap(0.0)))
    with pytest.raises(StepTooLargeError, match=r"epoch 8 .*: expected work in 300 MiB of memory"):
        worker.do(Hoard(1000))
    seen.add(worker.do(Nap(0.0)))
    with pytest.raises(WorkerDiedError, match="nothing was taken in"):
        worker.do(Crash())
    seen.add(worker.do(Nap(0.0)))
    assert len(seen) == 5
    assert os.getpid() not in seen


def test_an_error_comes_without_its_causes(worker: Worker) -> None:
    """What led to an error stays in the process: rebuilding it would keep the whole server waiting."""
    with pytest.raises(InputError, match="expected less than 50") as caught:
        worker.do(Stumble(50))
    assert caught.value.__cause__ is None
    assert caught.value.__context__ is None


def test_a_step_that_waits_for_the_processor_is_not_too_long(worker: Worker) -> None:
    """What counts is processor time: on a busy machine a step is not given up for others' work."""
    assert worker.do(Nap(2.0, step="epoch 0"))


def test_an_answer_comes_in_time(
    database: str,
    make_request: Callable[..., Any],
    sweep_request: Callable[..., Any],
    epochs_request: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the work takes longer than a request may, 504 at that time; the same again is fine later."""
    settings = load_settings(database_url=database, workers=0, request_timeout_s=1.0, prompt_s=60.0)
    fold = LocalWorker.fold

    def slow(self: LocalWorker, job: Job) -> Folded:
        time.sleep(2.0)
        return fold(self, job)

    with TestClient(create_app(settings), base_url="http://localhost", client=("127.0.0.1", 5000)) as client:
        url = client.post("/v1/sessions", json=make_request()).headers["Location"]
        client.post(f"{url}/sweeps", json=sweep_request())
        with monkeypatch.context() as patch:
            patch.setattr(LocalWorker, "fold", slow)
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
