"""Limits and bad input: a clear answer, nothing taken in, never a 5xx of our own making."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.errors import BusyError
from service.session.fold import Job
from service.session.worker import LocalWorker
from service.settings import load_settings
from service.storage.folded import Folded


def _tight(database: str, **settings: Any) -> TestClient:
    app = create_app(load_settings(database_url=database, workers=0, **settings))
    return TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000))


def test_sizes_are_limited(
    database: str,
    make_request: Callable[..., Any],
    sweep_request: Callable[[], Any],
    epochs_request: Callable[..., Any],
) -> None:
    """Anchors, walls, epochs, paths and bytes beyond the operator's limits: 413; sessions: 429."""
    limits = {"max_anchors": 2, "max_walls": 3, "max_epochs_per_request": 5, "max_sessions_per_key": 2}
    with _tight(database, max_body_bytes=20_000, max_paths_per_anchor=30, **limits) as client:
        assert client.post("/v1/sessions", json=make_request(anchors=["a", "b", "c"])).status_code == 413
        url = client.post("/v1/sessions", json=make_request()).headers["Location"]
        assert client.post(f"{url}/sweeps", json=sweep_request()).status_code == 200
        more = {**sweep_request(), "sweep": 1}
        assert client.post(f"{url}/sweeps", json=more).status_code == 413
        assert client.post(f"{url}/epochs", json=epochs_request(0, 6)).status_code == 413
        many = epochs_request(0, 1)
        many["epochs"][0]["anchors"]["pa1"] = {"delay_s": [1e-7] * 31, "delay_std_s": [1e-10] * 31}
        assert client.post(f"{url}/epochs", json=many).status_code == 413
        for body, got in ((b"[" * 20_001, "20001"), (iter([b"[" * 15_000] * 2), "more")):
            answer = client.post(f"{url}/epochs", content=body, headers={"Content-Type": "application/json"})
            assert answer.status_code == 413
            assert answer.headers["content-type"] == "application/problem+json"
            assert answer.json()["detail"] == f"body: expected at most 20000 bytes, got {got}"
        assert client.get(url).json()["next_epoch"] == 0
        assert client.post("/v1/sessions", json=make_request()).status_code == 201
        full = client.post("/v1/sessions", json=make_request())
        assert full.status_code == 429
        assert int(full.headers["Retry-After"]) > 0


def _epoch(anchors: bytes) -> bytes:
    return b'{"epochs": [{"epoch": 0, "time_s": 0, "anchors": ' + anchors + b"}]}"


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"null",
        b"[]",
        b'{"epochs": []}',
        b'{"epochs": [{"epoch": 0, "time_s": NaN, "anchors": {}}]}',
        b'{"epochs": [{"epoch": 0, "time_s": 1e999, "anchors": {}}]}',
        b'{"epochs": [{"epoch": -1, "time_s": 0, "anchors": {}}]}',
        b'{"epochs": [{"epoch": 1e300, "time_s": 0, "anchors": {}}]}',
        b'{"epochs": [{"epoch": 99999999999999999999, "time_s": 0, "anchors": {}}]}',
        _epoch(b'{"pa1": {"delay_s": [0], "delay_std_s": [1]}}'),
        _epoch(b'{"pa1": {"delay_s": [1, 2], "delay_std_s": [1]}}'),
        _epoch(b'{"pa1": {"delay_s": [1]}}'),
        _epoch(b'{"pa1": {"delay_s": ["1e-7"], "delay_std_s": [1e-10]}}'),
        b'{"epochs": [{"epoch": false, "time_s": 0, "anchors": {}}]}',
        b'{"epochs": [{"epoch": 0, "time_s": true, "anchors": {}}]}',
        _epoch(b'{"\\u0000": {"delay_s": [], "delay_std_s": []}}'),
        _epoch(b'{"\\ud800": {"delay_s": [], "delay_std_s": []}}'),
        b'{"epochs": 1' + b"0" * 5000 + b"}",
        b"[" * 100_000,
        b'{"a":' * 50_000,
        b"\xff\xfe\x00",
    ],
)
def test_bad_bodies_are_refused(client: TestClient, session_url: str, body: bytes) -> None:
    """Whatever it is, the answer is a problem document of 4xx that repeats no more than a line."""
    answer = client.post(f"{session_url}/epochs", content=body, headers={"Content-Type": "application/json"})
    assert 400 <= answer.status_code < 500, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < 20_000
    assert client.get(session_url).json()["next_epoch"] == 0


def test_wild_figures_do_no_harm(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any]
) -> None:
    """Figures that pass the schema but make no sense are taken in or refused, never half of either."""
    rng = np.random.default_rng(5)
    for _ in range(30):
        scale = 10.0 ** rng.uniform(-14, 14, size=(2, 6))
        paths = {"delay_s": scale[0].tolist(), "delay_std_s": scale[1].tolist()}
        epoch = {"epoch": 0, "time_s": 0.0, "anchors": {"pa1": paths}}
        answer = client.post(f"{session_url}/epochs", json={"epochs": [{**epoch}]})
        assert answer.status_code in (200, 409, 422), answer.text
        if answer.status_code == 200:
            assert np.all(np.isfinite(answer.json()["state"]["agent"]["position_m"]))
    assert client.get(session_url).json()["next_epoch"] in (0, 1)


def test_problems_say_where_and_what(client: TestClient) -> None:
    """A validation problem names the field, what was expected and what came, and the request."""
    body = {"anchors": ["a"], "carrier_hz": "fast"}
    answer = client.post("/v1/sessions", json=body, headers={"X-Request-Id": "abc-1"})
    problem = answer.json()
    assert answer.status_code == problem["status"] == 422
    assert problem["errors"][0]["where"] == "body.carrier_hz"
    assert problem["errors"][0]["got"] == "'fast'"
    assert problem["request_id"] == answer.headers["X-Request-Id"] == "abc-1"


_JSON = "application/json"


@pytest.mark.parametrize(
    ("method", "path", "headers", "content", "status", "detail"),
    [
        ("GET", "/nowhere", {}, b"", 404, "expected an address that /docs tells of, got GET /nowhere"),
        ("PATCH", "/v1/sessions", {}, b"", 405, "expected GET, POST, got PATCH /v1/sessions"),
        ("POST", "/v1/sessions", {"Content-Type": "text/plain"}, b"{}", 415, "got text/plain"),
        ("POST", "/v1/sessions", {"Content-Type": _JSON, "Content-Encoding": "br"}, b"{}", 415, "got br"),
        ("POST", "/v1/sessions", {"Content-Type": _JSON}, b'{"a" 1}', 422, "at character 5"),
        (
            "POST",
            "/v1/sessions",
            {"Content-Type": _JSON},
            b"{}",
            422,
            "body.anchors: Field required, got nothing",
        ),
    ],
)
def test_errors_have_one_shape(
    client: TestClient,
    method: str,
    path: str,
    headers: dict[str, str],
    content: bytes,
    status: int,
    detail: str,
) -> None:
    """Also of what no route sees: a problem document that says what was expected and what came."""
    answer = client.request(method, path, headers=headers, content=content)
    problem = answer.json()
    assert answer.status_code == problem["status"] == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert detail in problem["detail"]
    assert problem["type"].startswith("urn:hapslam:problem:")
    assert problem["request_id"] == answer.headers["X-Request-Id"]
    assert answer.headers.get("Allow") == ("GET, POST" if status == 405 else None)


def test_a_full_queue_is_told_to_come_again(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """429 with Retry-After, nothing taken in, and the same request is fine later."""

    def busy(self: LocalWorker, job: Job) -> Folded:
        raise BusyError("expected a free worker, 64 requests wait already")

    with monkeypatch.context() as patch:
        patch.setattr(LocalWorker, "fold", busy)
        answer = post_epochs(session_url, 0, 3)
    assert answer.status_code == 429
    assert answer.headers["Retry-After"] == "1"
    assert post_epochs(session_url, 0, 3).status_code == 200


def test_bugs_show_no_traceback(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What no one foresaw is a plain 500; the details are in the log."""

    def broken(self: LocalWorker, job: Job) -> Folded:
        raise ZeroDivisionError("secret detail")

    monkeypatch.setattr(LocalWorker, "fold", broken)
    answer = post_epochs(session_url, 0, 1)
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert answer.json()["type"].endswith("internal")


def test_files_of_the_page_are_those_and_no_others(client: TestClient) -> None:
    """No path from a client is ever followed."""
    assert client.get("/web/..%2fapp.py").status_code == 404
    assert client.get("/web/%2e%2e/app.py").status_code == 404
    assert client.get("/web/app.py").status_code == 404


def test_the_interface_describes_itself(client: TestClient) -> None:
    """The OpenAPI document names all routes and gives examples for what is posted."""
    document = client.get("/openapi.json").json()
    paths = document["paths"]
    assert "/v1/sessions/{session_id}/epochs" in paths
    text = json.dumps(document["components"]["schemas"]["EpochsRequest"])
    assert "examples" in text
