"""What one client sends costs that client alone: bounds on work, and answers that say which."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import httpx2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from estimator.measurements import MeasurementSet
from service.api.app import create_app
from service.client import Client, UnexpectedAnswerError
from service.session.fold import Job
from service.session.worker import LocalWorker
from service.settings import load_settings
from service.storage.folded import Folded
from tests.hostile_files import BOMBS, measurement_file

BINARY = {"Content-Type": "application/octet-stream"}


def _epoch(number: int, anchors: list[str], paths: int, walls: int = 0) -> dict[str, Any]:
    columns = {"delay_s": np.linspace(1e-8, 4e-7, paths).tolist(), "delay_std_s": [3e-10] * paths}
    wall = {"vrp_m": [8.0, 1.0], "covariance_m2": [[0.01, 0.0], [0.0, 0.01]]}
    return {
        "epoch": number,
        "time_s": float(number),
        "anchors": dict.fromkeys(anchors, columns),
        "sweep": [wall] * walls,
    }


def test_anchors_times_paths_times_walls_are_limited(client: TestClient) -> None:
    """Each number within its limit, all together ten gigabytes: refused by their product, at once."""
    anchors = [f"a{i}" for i in range(64)]
    url = client.post("/v1/sessions", json={"anchors": anchors, "carrier_hz": 28e9}).headers["Location"]
    wall = {"covariance_m2": [[0.01, 0.0], [0.0, 0.01]]}
    walls = [{"vrp_m": [9.0 + i, 1.0], **wall} for i in range(64)]
    assert client.post(f"{url}/sweeps", json={"sweep": 0, "walls": walls}).status_code == 200
    answer = client.post(f"{url}/epochs", json={"epochs": [_epoch(0, anchors, 200)]})
    assert answer.status_code == 413
    assert "12800 paths beside 64 walls" in answer.json()["detail"]
    assert client.get(url).json()["next_epoch"] == 0


def test_walls_seen_on_the_way_are_limited(client: TestClient, session_url: str) -> None:
    """A sweep within an epoch has as many walls as one at the start may have, and no more."""
    answer = client.post(f"{session_url}/epochs", json={"epochs": [_epoch(0, ["pa1"], 2, walls=65)]})
    assert answer.status_code == 413
    assert "at most 64 walls in a sweep" in answer.json()["detail"]


# A chunk that expands without end is stopped by the memory of a worker process: test_hostile_files.py.
@pytest.mark.parametrize("kind", sorted(set(BOMBS) - {"expanding_chunk"}))
def test_bombs_are_refused(
    client: TestClient, session_url: str, walk: MeasurementSet, tmp_path: Any, kind: str
) -> None:
    """Files that unpack to too much, or are not what they say, are refused in every route: no 5xx."""
    canary = tmp_path / "canary.bin"
    canary.write_bytes(b"x" * 1000)
    body = BOMBS[kind](measurement_file(walk, tmp_path), canary)
    of_session = [f"{session_url}/{leaf}" for leaf in ("datasets", "channels", "sweeps")]
    for path in ("/v1/uploads", *of_session):
        answer = client.post(path, content=body, params={"noise_variance": 1}, headers=BINARY)
        assert answer.status_code in (409, 413, 422), (path, answer.text)
        assert str(tmp_path) not in answer.text


def test_a_slow_session_does_not_hold_the_quick_workers(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Epochs that take longer than a moment are begun anew where they keep nobody waiting."""
    jobs: list[float | None] = []
    fold = LocalWorker.fold

    def slow(self: LocalWorker, job: Job) -> Folded:
        jobs.append(job.prompt_s)
        return fold(self, job)

    monkeypatch.setattr(LocalWorker, "fold", slow)
    with monkeypatch.context() as patch:
        clock = iter(np.arange(0.0, 1e6, 0.4))
        patch.setattr("service.session.fold.time.thread_time", lambda: next(clock))
        assert post_epochs(session_url, 0, 5).status_code == 200
    assert [job is None for job in jobs][-1]
    assert jobs[0] is not None
    assert client.get(session_url).json()["next_epoch"] == 5


def test_pictures_are_drawn_once(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture of an epoch never changes: asked for again it is sent, not drawn; new epochs are drawn."""
    drawn: list[str] = []
    work = LocalWorker.do

    def noted(self: LocalWorker, task: Any) -> Any:
        drawn.append(type(task).__name__)
        return work(self, task)

    monkeypatch.setattr(LocalWorker, "do", noted)
    post_epochs(session_url, 0, 3)
    first = client.get(f"{session_url}/map.png").content
    assert client.get(f"{session_url}/map.png", params={"epoch": 2}).content == first
    assert drawn.count("PictureRead") == 1
    post_epochs(session_url, 3, 5)
    assert client.get(f"{session_url}/map.png").content != first
    assert drawn.count("PictureRead") == 2


def test_names_with_dollars_are_drawn(
    client: TestClient, make_session: Callable[..., str], walk: MeasurementSet, tmp_path: Any
) -> None:
    """A name is text, not mathematics, whatever characters it has."""
    names = ["$x_{", "a$b$^"]
    url = make_session(sweep=True, anchors=names, name=r"$\frac{$ & <b> \\")
    epochs = [
        {
            "epoch": epoch.index,
            "time_s": epoch.time_s,
            "anchors": {
                name: {"delay_s": paths.delay_s.tolist(), "delay_std_s": paths.delay_std_s.tolist()}
                for name, paths in zip(names, epoch.paths, strict=True)
            },
        }
        for epoch in walk.epochs[:30]
    ]
    assert client.post(f"{url}/epochs", json={"epochs": epochs}).status_code == 200
    assert any(anchor["located"] for anchor in client.get(f"{url}/state").json()["anchors"])
    for suffix in ("png", "svg"):
        assert client.get(f"{url}/map.{suffix}").status_code == 200


def test_the_client_repeats_what_passes_and_nothing_else() -> None:
    """A step that takes too long takes too long again: 422 is not repeated; busy is, after the pause."""
    asked: list[int] = []
    answers = iter([429, 503, 422])

    def answer(request: httpx2.Request) -> httpx2.Response:
        status = next(answers)
        asked.append(status)
        return httpx2.Response(status, json={"detail": "x"}, headers={"Retry-After": "0"})

    client = Client("http://localhost", patience_s=0.01)
    client._http = httpx2.Client(base_url="http://localhost", transport=httpx2.MockTransport(answer))
    with client, pytest.raises(UnexpectedAnswerError) as caught:
        client.post_epochs("0" * 32, [])
    assert (caught.value.status, asked) == (422, [429, 503, 422])


def test_probes_answer_while_everything_else_waits(database: str) -> None:
    """With all threads for the database taken, the probes and the refusal of strangers still answer."""
    app = create_app(load_settings(database_url=database, workers=0))
    with TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000)) as client:
        here, held = app.state.context, threading.Event()
        portal = client.portal
        assert portal is not None
        waiting = [portal.start_task_soon(here.run, held.wait) for _ in range(80)]
        try:
            begin = time.monotonic()
            guard = threading.Timer(20.0, held.set)
            guard.start()
            assert client.get("/livez").status_code == 200
            assert client.get("/readyz").json() == {"status": "ready"}
            assert time.monotonic() - begin < 10.0
        finally:
            guard.cancel()
            held.set()
        for task in waiting:
            task.result(10.0)
