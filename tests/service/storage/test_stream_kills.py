"""Streams of epochs whose server is killed, again and again: what was answered is there, once and exactly."""

from __future__ import annotations

import json
import os
import random
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from estimator.measurements import MeasurementSet
from estimator.result import SlamResult, load_result
from service.client import Client
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from tests.service.harness import SEED, Server

KILLS = int(os.environ.get("HAPSLAM_TEST_KILLS", "2"))
_PAUSE_S = 0.02  # between epochs of a stream, so that it lasts as long as a few kills
Send = Callable[[str, str, list[Any]], Iterator[int]]


def _by_lines(url: str, session: str, entries: list[Any]) -> Iterator[int]:
    """Numbers of the epochs that were answered, of a body that comes slowly; ends when the server dies."""

    def body() -> Iterator[bytes]:
        for entry in entries:
            time.sleep(_PAUSE_S)
            yield json.dumps(entry).encode() + b"\n"

    headers = {"Content-Type": "application/x-ndjson"}
    address = f"{url}/v1/sessions/{session}/epochs/stream"
    try:
        with httpx2.stream("POST", address, content=body(), headers=headers, timeout=20.0) as answer:
            for line in answer.iter_lines():
                yield _number(line)
    except httpx2.TransportError:
        return


def _by_messages(url: str, session: str, entries: list[Any]) -> Iterator[int]:
    """The same over a WebSocket."""
    address = f"{url.replace('http', 'ws', 1)}/v1/sessions/{session}/socket"
    try:
        with connect(address, open_timeout=20.0, close_timeout=0.1) as socket:
            for entry in entries:
                time.sleep(_PAUSE_S)
                socket.send(json.dumps(entry))
                yield _number(socket.recv(timeout=20.0))
    except (WebSocketException, OSError, TimeoutError):
        return


def _number(line: str | bytes) -> int:
    answer = json.loads(line)
    assert "problem" not in answer, answer
    return int(answer["epoch"])


@pytest.mark.parametrize("send", [_by_lines, _by_messages])
def test_streams_outlive_kills(
    database: str, walk: MeasurementSet, reference: SlamResult, send: Send, tmp_path: Path
) -> None:
    """After each kill the stream is taken up where the session is; the run is that of no kill at all."""
    dice, kills, enough = random.Random(KILLS), 0, threading.Event()
    entries = [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs]
    server = Server(database)
    server.start()
    killed = threading.Semaphore(0)

    def kill() -> None:
        nonlocal kills
        while kills < KILLS and not enough.is_set():
            time.sleep(dice.uniform(0.1, 0.8))
            server.kill()
            kills += 1
            server.start()
            killed.release()

    killer = threading.Thread(target=kill)
    try:
        with Client(server.url, attempts=100_000, patience_s=0.2, timeout_s=20.0) as client:
            killer.start()
            while kills < KILLS or not enough.is_set():
                session = client.create_session(session_entry(walk, seed=SEED))
                client.post_sweep(session, sweep_entry(walk))
                answered = -1
                while (there := client.session(session)["next_epoch"]) < len(entries):
                    assert there > answered, f"epoch {answered} was answered, the session expects {there}"
                    for number in send(server.url, session, entries[max(0, there - dice.randrange(3)) :]):
                        answered = max(answered, number)
                file = tmp_path / f"{session}.nc"
                file.write_bytes(client.export(session))
                result = load_result(file)
                for name in ("agent_mean", "agent_covariance", "log_evidence"):
                    assert np.array_equal(getattr(result, name), getattr(reference, name)), name
                if kills >= KILLS:
                    enough.set()
    finally:
        enough.set()
        killer.join()
        server.kill()
    assert kills >= KILLS
