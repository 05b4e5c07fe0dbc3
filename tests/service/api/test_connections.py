"""Connections that keep the server waiting, and its end in spite of all that waits."""

from __future__ import annotations

import json
import socket
import threading
import time

import httpx2
import pytest

from estimator.measurements import MeasurementSet
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from tests.service.harness import Server

_PATIENCE_S = 60.0  # of the test, not of the server


def _closed_after(port: int, sent: bytes, every_s: float = 0.0) -> float:
    """Seconds until the server closes a connection that sends something, again and again or once."""
    begin = time.monotonic()
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.settimeout(0.2 if every_s else _PATIENCE_S)
        connection.sendall(sent)
        while time.monotonic() - begin < _PATIENCE_S:
            try:
                if connection.recv(65536) == b"":
                    return time.monotonic() - begin
            except TimeoutError:
                connection.sendall(b"x")
            except ConnectionError:
                return time.monotonic() - begin
    return float("inf")


def test_connections_that_keep_waiting_are_closed(database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing sent, half a head, a head letter by letter, an endless one, a body that stops: each ends."""
    monkeypatch.setenv("HAPSLAM_HEAD_TIMEOUT_S", "1")
    monkeypatch.setenv("HAPSLAM_BODY_STALL_S", "1")
    half = b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: "
    body = b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    body += b"Content-Length: 9\r\nConnection: close\r\n\r\n{"
    with Server(database, workers=1) as server:
        for sent, every_s in (
            (b"", 0.0),
            (half, 0.0),
            (half, 0.2),
            (half + b"x" * 100_000, 0.0),
            (body, 0.0),
        ):
            assert _closed_after(server.port, sent, every_s) < 0.5 * _PATIENCE_S, sent[:80]
        assert httpx2.get(f"{server.url}/livez").status_code == 200


def _waiting(client: httpx2.Client) -> float:
    """Requests that wait for a worker, as the server counts them."""
    lines = client.get("/metrics").text.splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("hapslam_steps_waiting"))


def test_the_end_does_not_wait_for_pictures(
    database: str, walk: MeasurementSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGTERM with many pictures asked for: those that wait are told so, and the server ends in time."""
    monkeypatch.setenv("HAPSLAM_DRAIN_S", "2")
    statuses: list[int] = []
    with Server(database, workers=1) as server, Client(server.url) as client:
        session = client.create_session(session_entry(walk))
        client.post_sweep(session, sweep_entry(walk))
        client.post_epochs(session, [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs])

        asking = httpx2.Client(base_url=server.url, timeout=60.0, limits=httpx2.Limits(max_connections=50))

        def ask(epoch: int) -> None:
            try:
                answer = asking.get(f"/v1/sessions/{session}/map.png", params={"epoch": epoch})
                statuses.append(answer.status_code)
            except httpx2.TransportError:
                statuses.append(0)

        threads = [threading.Thread(target=ask, args=(n,)) for n in range(40)]
        for thread in threads:
            thread.start()
        while _waiting(asking) < 20 and len(statuses) < 20:
            time.sleep(0.05)
        begin = time.monotonic()
        assert server.stop(patience_s=60.0) == 0
        took_s = time.monotonic() - begin
        for thread in threads:
            thread.join()
        asking.close()
    assert took_s < 2.0 + 20.0  # the drain, and a busy machine's time to end processes
    assert statuses.count(503) >= 10
    assert set(statuses) <= {0, 200, 503}, json.dumps(statuses)
