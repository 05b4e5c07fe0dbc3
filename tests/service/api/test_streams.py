"""Epochs one a line or one a message: answered when on disk, all that is good, packed bodies beside."""

from __future__ import annotations

import gzip
import json
import time
from collections.abc import Callable
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from httpx2 import Response
from starlette.websockets import WebSocketDisconnect

from service.api.auth import KeyRing
from service.api.unpacking import zstd

_LINES = {"Content-Type": "application/x-ndjson"}


def _lines(epochs: list[Any]) -> list[bytes]:
    return [json.dumps(epoch).encode() + b"\n" for epoch in epochs]


@pytest.fixture
def epochs(epochs_request: Callable[[int, int], Any]) -> list[Any]:
    """The walk's first twelve epochs."""
    return list(epochs_request(0, 12)["epochs"])


@pytest.fixture
def stream(client: TestClient) -> Callable[..., list[Any]]:
    """Sends lines to a session; the answers."""

    def send(url: str, pieces: list[bytes], query: str = "") -> list[Any]:
        answer = client.post(f"{url}/epochs/stream{query}", content=iter(pieces), headers=_LINES)
        assert answer.status_code == 200, answer.text
        return [json.loads(line) for line in answer.text.splitlines()]

    return send


def test_lines_give_the_states_of_a_request(
    client: TestClient,
    make_session: Callable[..., str],
    epochs: list[Any],
    stream: Callable[..., list[Any]],
    post_epochs: Callable[..., Response],
) -> None:
    """Each line is answered once, in order; the state is that of one request; again nothing is new."""
    one, other = make_session(), make_session()
    state = post_epochs(other, 0, 12).json()["state"]
    body = b"".join(_lines(epochs))
    pieces = [body[first : first + 777] for first in range(0, len(body), 777)]
    answers = stream(one, pieces, "?state=true")
    assert [answer["epoch"] for answer in answers] == list(range(12))
    assert all(answer["new"] for answer in answers)
    assert answers[-1]["state"] == state
    assert client.get(f"{one}/state").json() == state
    again = stream(one, [body[:-1]])  # without the end of the last line
    assert [answer["new"] for answer in again] == [False] * 12


@pytest.mark.parametrize(
    ("wrong", "status"),
    [
        (b"{broken\n", 422),
        (b'{"epoch": 99, "time_s": 1e6, "anchors": {}}\n', 409),
        (b'{"epoch": 4, "time_s": 4.0, "anchors": {"pa9": {"delay_s": [], "delay_std_s": []}}}\n', 422),
        (b'{"epoch": 4, "time_s": 4.0, "anchors": {}, "note": "' + b"x" * 3_000_000 + b'"}\n', 413),
    ],
)
def test_what_is_good_before_a_wrong_line_is_kept(
    client: TestClient,
    session_url: str,
    epochs: list[Any],
    stream: Callable[..., list[Any]],
    wrong: bytes,
    status: int,
) -> None:
    """The lines before are taken in and answered, the wrong one is told, nothing after it is taken in."""
    lines = _lines(epochs)
    answers = stream(session_url, [b"".join([*lines[:4], wrong, *lines[4:]])])
    kept = 4 if status != 413 else len(answers) - 1  # a line too long may end the stream before others
    assert [answer.get("epoch") for answer in answers[:-1]] == list(range(kept))
    assert answers[-1]["problem"]["status"] == status
    assert client.get(session_url).json()["next_epoch"] == kept
    assert [answer["new"] for answer in stream(session_url, lines)] == [False] * kept + [True] * (12 - kept)


def test_a_stream_is_of_lines(client: TestClient, session_url: str) -> None:
    """Another type is refused by its head, and a session that is not there is 404."""
    json_type = {"Content-Type": "application/json"}
    assert client.post(f"{session_url}/epochs/stream", content=b"{}", headers=json_type).status_code == 415
    packed = {**_LINES, "Content-Encoding": "gzip"}
    assert client.post(f"{session_url}/epochs/stream", content=b"{}", headers=packed).status_code == 415
    nowhere = f"/v1/sessions/{'0' * 32}/epochs/stream"
    assert client.post(nowhere, content=b"{}", headers=_LINES).status_code == 404


def test_a_socket_answers_every_message(client: TestClient, session_url: str, epochs: list[Any]) -> None:
    """Messages are answered like lines; a wrong one is told and ends it; what was sent before is kept."""
    with client.websocket_connect(f"ws://localhost{session_url}/socket?state=true") as socket:
        for number, epoch in enumerate(epochs[:5]):
            socket.send_text(json.dumps(epoch))
            answer = socket.receive_json()
            assert (answer["epoch"], answer["new"]) == (number, True)
        assert answer["state"] == client.get(f"{session_url}/state").json()
        socket.send_text("[]")
        assert socket.receive_json()["problem"]["status"] == 422
        with pytest.raises(WebSocketDisconnect):
            socket.receive_text()
    assert client.get(session_url).json()["next_epoch"] == 5


def test_sockets_want_a_key(client: TestClient) -> None:
    """With keys a socket needs one, in the header or as a subprotocol; it ends with its key."""
    app = client.app
    assert isinstance(app, FastAPI)
    ring = KeyRing(app.state.context.store.engine)
    mine, other = ring.create("mine"), ring.create("other", "read")
    time.sleep(1.1)  # that there are no keys is remembered for a second
    theirs = {"Authorization": f"Bearer {mine}"}
    session = client.post("/v1/sessions", json={"anchors": ["a"], "carrier_hz": 28e9}, headers=theirs)
    url = f"ws://localhost{session.headers['Location']}/socket"
    refused: list[tuple[dict[str, str], list[str] | None]] = [
        ({}, None),
        ({"Authorization": f"Bearer {other}"}, None),
        ({**theirs, "Origin": "http://evil.example"}, None),
        ({}, ["hapslam", "hapslam.key.rubbish"]),
    ]
    for headers, protocols in refused:
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect(url, headers=headers, subprotocols=protocols) as socket,
        ):
            socket.receive_text()
    with client.websocket_connect(url, subprotocols=["hapslam", f"hapslam.key.{mine}"]) as socket:
        assert socket.accepted_subprotocol == "hapslam"
        ring.revoke(mine.split("_")[1])
        assert socket.receive_json()["problem"]["status"] == 401


@pytest.fixture(params=["gzip", "zstd"])
def pack(request: pytest.FixtureRequest) -> tuple[str, Callable[[bytes], bytes]]:
    """Each encoding and what packs with it."""
    return request.param, {"gzip": gzip.compress, "zstd": zstd.compress}[request.param]


def test_packed_bodies_are_those_they_were(
    client: TestClient,
    make_session: Callable[..., str],
    epochs_request: Callable[[int, int], Any],
    post_epochs: Callable[..., Response],
    pack: tuple[str, Callable[[bytes], bytes]],
) -> None:
    """A packed request is answered as the plain one; incomplete or wrongly named it is refused."""
    name, packed = pack
    one, other = make_session(), make_session()
    body = json.dumps(epochs_request(0, 5)).encode()
    headers = {"Content-Type": "application/json", "Content-Encoding": name}
    sent = client.post(f"{one}/epochs", content=packed(body), headers=headers)
    assert sent.status_code == 200, sent.text
    assert sent.json() == post_epochs(other, 0, 5).json()
    for wrong in (packed(body)[:-4], body):
        assert client.post(f"{one}/epochs", content=wrong, headers=headers).status_code == 422


def test_packed_bodies_have_the_limit_of_plain_ones(
    client: TestClient, session_url: str, pack: tuple[str, Callable[[bytes], bytes]]
) -> None:
    """A kilobyte that unpacks to a gigabyte is refused at the limit."""
    name, packed = pack
    headers = {"Content-Type": "application/json", "Content-Encoding": name}
    bomb = packed(bytes(64 * 2**20))
    assert len(bomb) < 2**20
    begin = time.perf_counter()
    answer = client.post(f"{session_url}/epochs", content=bomb, headers=headers)
    assert answer.status_code == 413
    assert "unpack to at most" in answer.json()["detail"]
    assert time.perf_counter() - begin < 5.0
