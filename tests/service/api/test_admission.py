"""Who is let in, decided before anything of a body is read."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from service.api.admission import BodyBudget
from service.api.app import create_app
from service.api.auth import KeyRing
from service.errors import BusyError
from service.settings import load_settings


@pytest.fixture
def app(database: str) -> Iterator[FastAPI]:
    """A running application with small limits."""
    limits = {"max_body_bytes": 2**20, "max_json_bytes": 2**19, "max_small_json_bytes": 2**14}
    application = create_app(load_settings(database_url=database, workers=0, body_stall_s=0.2, **limits))
    with TestClient(application, base_url="http://localhost", client=("127.0.0.1", 5000)):
        yield application


class Exchange:
    """One request given to the application piece by piece, and its answer."""

    def __init__(self, app: FastAPI, path: str, pieces: list[bytes] | None, **headers: str) -> None:
        self.asked_for, self.status, self.body = 0, 0, b""
        self._app, self._pieces = app, pieces
        self._scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": "POST",
            "scheme": "http",
            "path": path,
            "raw_path": path.encode(),
            "query_string": b"",
            "root_path": "",
            "headers": [(b"host", b"localhost")]
            + [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()],
            "client": ("127.0.0.1", 5000),
            "server": ("localhost", 80),
        }

    async def _receive(self) -> dict[str, Any]:
        self.asked_for += 1
        if not self._pieces:
            await asyncio.sleep(3600)
        assert self._pieces
        piece = self._pieces.pop(0)
        return {"type": "http.request", "body": piece, "more_body": True}

    async def _send(self, message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
        self.body += message.get("body", b"")

    def run(self) -> Exchange:
        """Have it answered."""
        asyncio.run(self._app(self._scope, self._receive, self._send))  # type: ignore[arg-type]
        return self


def _key(app: FastAPI) -> str:
    return KeyRing(app.state.context.store.engine).create("ann")


def test_without_a_key_no_byte_of_a_body_is_read(app: FastAPI) -> None:
    """Whatever the route and the type, 401 comes from the head alone."""
    _key(app)
    time.sleep(1.1)  # that there are no keys is remembered for a second
    for path in ("/v1/sessions", "/v1/uploads", f"/v1/sessions/{'0' * 32}/epochs", "/v1/nowhere"):
        found = Exchange(app, path, [b"[" * 60_000], content_type="application/json").run()
        assert (found.status, found.asked_for) == (401, 0), path


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"content_type": "application/json", "content_length": "62000000"}, 413),
        ({"content_type": "application/json", "content_encoding": "br", "content_length": "9"}, 415),
        ({"content_type": "text/plain", "content_length": "9"}, 415),
        ({"content_length": "9"}, 415),
        ({"content_type": "application/json", "origin": "http://evil.example", "content_length": "9"}, 403),
        ({"content_type": "application/json", "sec_fetch_site": "cross-site", "content_length": "9"}, 403),
    ],
)
def test_a_head_is_enough_to_refuse(app: FastAPI, headers: dict[str, str], status: int) -> None:
    """Too large, packed, of another type, of another origin's page: refused before the body is read."""
    found = Exchange(app, "/v1/sessions", [b"{}"], **headers).run()
    assert (found.status, found.asked_for) == (status, 0)
    assert json.loads(found.body)["status"] == status


def test_a_page_of_this_service_is_let_in(client: TestClient, make_request: Callable[..., Any]) -> None:
    """The browser says of the service's own page that it is of the same origin."""
    own = {"Origin": "http://localhost", "Sec-Fetch-Site": "same-origin"}
    assert client.post("/v1/sessions", json=make_request(), headers=own).status_code == 201
    other = {"Origin": "http://localhost.evil.example"}
    assert client.post("/v1/sessions", json=make_request(), headers=other).status_code == 403
    assert client.get("/v1/sessions", headers={"Sec-Fetch-Site": "same-site"}).status_code == 403


def test_json_has_a_limit_of_its_own(client: TestClient, session_url: str) -> None:
    """What only files need is not allowed for JSON: 16 MiB for epochs, 256 KiB for the rest."""
    for path, size in (
        (f"{session_url}/epochs", 17 * 2**20),
        ("/v1/sessions", 2**19),
        (f"{session_url}/sweeps", 2**19),
    ):
        answer = client.post(path, content=bytes(size), headers={"Content-Type": "application/json"})
        assert answer.status_code == 413, path


def test_a_body_that_does_not_come_is_given_up(app: FastAPI) -> None:
    """A piece, then nothing: 408, after the time that a piece may take."""
    begin = time.perf_counter()
    found = Exchange(app, "/v1/sessions", [b"{"], content_type="application/json", content_length="90").run()
    assert found.status == 408
    assert time.perf_counter() - begin < 5.0


def test_bodies_share_a_budget() -> None:
    """A key may have half of all bytes; what was claimed is free again at the end."""
    budget = BodyBudget(100)
    with budget.claim("a") as of_a:
        of_a(50)
        with pytest.raises(BusyError, match="many others are being received"):
            of_a(1)
        with budget.claim("b") as of_b, budget.claim("c") as of_c:
            of_b(40)
            with pytest.raises(BusyError):
                of_c(20)
    with budget.claim("a") as of_a:
        of_a(50)


def test_large_bodies_are_parsed_by_workers(app: FastAPI, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than a few kilobytes of epochs never reach the parser on the event loop."""
    seen: list[str] = []
    work = type(app.state.context).work

    async def noted(self: Any, lane: Any, *rest: Any) -> Any:
        seen.append(str(lane))
        return await work(self, lane, *rest)

    monkeypatch.setattr(type(app.state.context), "work", noted)
    client = TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000))
    made = client.post("/v1/sessions", json={"anchors": ["a"], "carrier_hz": 28e9})
    url = made.headers["Location"]
    for size, lanes in ((1_000, []), (200_000, ["bulk"])):
        body = b'{"epochs":[' + b",".join([b"1"] * (size // 2)) + b"]}"
        answer = client.post(f"{url}/epochs", content=body, headers={"Content-Type": "application/json"})
        assert (answer.status_code, seen) == (422, lanes)
        assert len(answer.content) < 20_000
