"""The service under load: how many epochs a second, and how long they wait.

A server is started on a database of its own; sessions send one epoch per request at a
steady rate, each waiting for its answer before the next. Then the same connections ask a
route that does nothing, for comparison: what is lost between the two is this service's.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.bench.server import running
from service.client import Client
from service.session.example import example

__all__ = ["LoadConfig", "measure_load"]


@dataclass(frozen=True)
class LoadConfig:
    """The load.

    Parameters
    ----------
    sessions : int
        Sessions that send at the same time.
    seconds : float
        How long.
    rate_hz : float
        Epochs a second of all sessions together; 0 for as many as can be.
    workers : int
        Processes that step sessions.
    most_hz : float
        Epochs a second that there are sessions for; who has sent them all is done.
    """

    sessions: int = 50
    seconds: float = 60.0
    rate_hz: float = 160.0
    workers: int = 2
    most_hz: float = 1000.0


@dataclass
class _Tally:
    waits_s: list[float] = field(default_factory=list)
    errors: int = 0


def measure_load(config: LoadConfig, database: str | None = None) -> dict[str, Any]:
    """Start a server, load it, stop it.

    Parameters
    ----------
    config : LoadConfig
        The load.
    database : str, optional
        URL of the database; by default a SQLite file in a temporary folder.

    Returns
    -------
    dict
        ``epochs_per_s``, ``p50_ms``, ``p99_ms``, ``errors``, ``start_s``; ``nothing_per_s``
        and ``nothing_p99_ms`` of a route that does nothing; ``batch_s``, the time of
        ``batch_epochs`` epochs in one request; ``memory_mib``, resident, of all processes.

    Raises
    ------
    HapslamError
        If the server does not start.
    """
    with running(config.workers, database) as server:
        return {"start_s": server.start_s, **_load(config, server.port), "memory_mib": server.memory_mib()}


def _load(config: LoadConfig, port: int) -> dict[str, Any]:
    shipped = example(1)
    bodies = [json.dumps({"epochs": [epoch]}).encode() for epoch in shipped["epochs"]]
    with Client(f"http://127.0.0.1:{port}") as client:
        most = max(config.rate_hz, config.most_hz) * config.seconds
        rounds = 1 + int(most / (config.sessions * len(bodies)))
        paths = [
            [f"/v1/sessions/{_session(client, shipped)}/epochs" for _ in range(rounds)]
            for _ in range(config.sessions)
        ]
        batch_s = min(
            _batch_s(client, shipped) for _ in range(2 * config.workers + 1)
        )  # and all workers warm
        steps = asyncio.run(_send(config, port, paths, bodies))
        nothing = asyncio.run(
            _send(LoadConfig(config.sessions, min(5.0, config.seconds), 0.0), port, None, bodies)
        )
    return {
        **_figures(steps, ""),
        **_figures(nothing, "nothing_"),
        "batch_epochs": len(bodies),
        "batch_s": batch_s,
    }


def _session(client: Client, shipped: dict[str, Any]) -> str:
    session = client.create_session(shipped["session"])
    client.post_sweep(session, shipped["sweep"])
    return session


def _batch_s(client: Client, shipped: dict[str, Any]) -> float:
    """Seconds that all epochs in one request take."""
    session = _session(client, shipped)
    begin = time.perf_counter()
    client.post_epochs(session, shipped["epochs"])
    return time.perf_counter() - begin


def _figures(tally: tuple[_Tally, float], prefix: str) -> dict[str, Any]:
    waits, seconds = np.array(tally[0].waits_s), tally[1]
    rate = "epochs_per_s" if not prefix else "nothing_per_s"
    return {
        rate: len(waits) / seconds,
        f"{prefix}p50_ms": 1e3 * float(np.quantile(waits, 0.5)),
        f"{prefix}p99_ms": 1e3 * float(np.quantile(waits, 0.99)),
        f"{prefix}errors": tally[0].errors,
    }


async def _send(
    config: LoadConfig, port: int, paths: list[list[str]] | None, bodies: list[bytes]
) -> tuple[_Tally, float]:
    """Load the server over one connection a session; without paths, ask for nothing."""
    tally, begin = _Tally(), time.perf_counter()
    senders = [
        _sender(config, port, None if paths is None else paths[n], bodies, tally, begin, n)
        for n in range(config.sessions)
    ]
    await asyncio.gather(*senders)
    return tally, time.perf_counter() - begin


async def _sender(
    config: LoadConfig,
    port: int,
    paths: list[str] | None,
    bodies: list[bytes],
    tally: _Tally,
    begin: float,
    number: int,
) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    pause = config.sessions / config.rate_hz if config.rate_hz else 0.0
    due, sent = begin + pause * number / config.sessions, 0
    most = math.inf if paths is None else len(paths) * len(bodies)
    while sent < most and time.perf_counter() < begin + config.seconds:
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
        if paths is None:
            request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
        else:
            path, body = paths[sent // len(bodies)], bodies[sent % len(bodies)]
            head = (
                f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                f"Content-Length: {len(body)}\r\n\r\n"
            )
            request = head.encode() + body
        asked = time.perf_counter()
        writer.write(request)
        status = await _answer(reader)
        tally.waits_s.append(time.perf_counter() - asked)
        tally.errors += status != 200
        sent += 1
        due = max(due + pause, time.perf_counter() - pause)
    writer.close()
    await writer.wait_closed()


async def _answer(reader: asyncio.StreamReader) -> int:
    """Read an answer whole; its status."""
    head = await reader.readuntil(b"\r\n\r\n")
    lines = head.decode("latin-1").split("\r\n")
    for line in lines[1:]:
        name, _, value = line.partition(":")
        if name.lower() == "content-length":
            await reader.readexactly(int(value))
    return int(lines[0].split()[1])
