"""What the service costs: its start, epochs a second under load, one large request, memory over time."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace

from estimator.slam import run_slam
from service.bench.load import LoadConfig, measure_load
from service.bench.memory import POSTED, measure_memory
from service.bench.rows import Row
from service.bench.server import running
from service.client import Client
from service.session.example import example, example_measurements

__all__ = ["rows"]

_NOTHING = "a FastAPI route that does nothing, same run"
_LARGE, _STEP_M = 1461, 0.08  # epochs in one request, and how far apart they are
_MOST_PER_S_BAR, _MOST_P99_BAR_MS = 400.0, 250.0  # where each session sends as soon as it is answered
_LEAST_PER_S, _P99_BAR_MS, _LARGE_BAR_S, _START_BAR_S, _GROWTH_BAR_MIB = 150.0, 400.0, 6.0, 2.0, 32.0


def rows(quick: bool) -> Iterator[Row]:
    """Measure row by row.

    Parameters
    ----------
    quick : bool
        Seconds rather than minutes.
    """
    config = LoadConfig(seconds=5.0 if quick else 60.0)
    load = measure_load(config)
    what = f"{config.sessions} sessions for {config.seconds:.0f} s, one epoch a request"
    yield Row("service: start", load["start_s"], "s", _START_BAR_S, "floor: importing FastAPI", _imported_s())
    yield Row(
        f"{what}: an epoch, of all together",
        1e3 / load["epochs_per_s"],
        "ms",
        1e3 / _LEAST_PER_S,
        _NOTHING,
        1e3 / load["nothing_per_s"],
    )
    yield Row(f"{what}: median wait", load["p50_ms"], "ms", None, _NOTHING, load["nothing_p50_ms"])
    yield Row(
        f"{what}: 99 of 100 wait less", load["p99_ms"], "ms", _P99_BAR_MS, _NOTHING, load["nothing_p99_ms"]
    )
    yield Row(f"{what}: errors", load["errors"], "", 0.0)
    yield from _as_many_as_can_be(replace(config, rate_hz=0.0))
    large_s, alone_s = _large_s(1 if quick else 3), _alone_s()
    peer = "the same epochs without the service"
    yield Row(f"{_LARGE} epochs in one request", large_s, "s", _LARGE_BAR_S, peer, alone_s)
    memory = measure_memory(4_000 if quick else 100_000)
    name = f"memory of all processes ({POSTED}): growth over {memory.epochs} epochs after the first fifth"
    yield Row(name, max(memory.growth_mib, 0.0), "MiB", _GROWTH_BAR_MIB)


def _as_many_as_can_be(config: LoadConfig) -> Iterator[Row]:
    """Epochs where each session sends the next as soon as one is answered; the rate asked for is no bound."""
    load = measure_load(config)
    what = f"{config.sessions} sessions for {config.seconds:.0f} s, as many as can be"
    bar, nothing = 1e3 / _MOST_PER_S_BAR, 1e3 / load["nothing_per_s"]
    yield Row(f"{what}: an epoch, of all together", 1e3 / load["epochs_per_s"], "ms", bar, _NOTHING, nothing)
    wait, nothing = load["p99_ms"], load["nothing_p99_ms"]
    yield Row(f"{what}: 99 of 100 wait less", wait, "ms", _MOST_P99_BAR_MS, _NOTHING, nothing)
    yield Row(f"{what}: errors", load["errors"], "", 0.0)


def _imported_s() -> float:
    """Seconds that a process takes that only imports what serves."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import fastapi, uvicorn"], check=True)
    return time.perf_counter() - begin


def _alone_s() -> float:
    """Seconds that the engine takes for the epochs of the large request, in this process."""
    _, measured = example_measurements(1, _STEP_M)
    run_slam(replace(measured, epochs=measured.epochs[:2]))  # loads what was compiled
    begin = time.perf_counter()
    run_slam(replace(measured, epochs=measured.epochs[:_LARGE]))
    return time.perf_counter() - begin


def _large_s(repeats: int) -> float:
    """Seconds that many epochs in one request take; the best of some tries."""
    shipped = example(1, _STEP_M)
    epochs, taken = shipped["epochs"][:_LARGE], []
    with running(workers=1) as server, Client(f"http://127.0.0.1:{server.port}") as client:
        for _ in range(repeats):
            session = client.create_session(shipped["session"])
            client.post_sweep(session, shipped["sweep"])
            begin = time.perf_counter()
            client.post_epochs(session, epochs)
            taken.append(time.perf_counter() - begin)
    return min(taken)
