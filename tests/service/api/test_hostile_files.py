"""Hostile files and bodies by the hundred, against a server with real workers.

``HAPSLAM_TEST_HOSTILE`` says how many; in the soak they are thousands.
"""

from __future__ import annotations

import io
import json
import os
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch, GaussianVrp, MeasurementSet
from service.api.auth import KeyRing
from service.client import Client
from service.settings import load_settings
from service.storage.database import opened
from tests.hostile_files import BOMBS, CANARY, REACHING, measurement_file
from tests.service.harness import Server
from tests.service.watcher import Watcher

HOSTILE = int(os.environ.get("HAPSLAM_TEST_HOSTILE", "200"))
_MOST_MIB = 600.0  # of any process of the server
_LIVE_S = 0.25  # within which the server says that it lives, always
_SECRET = "another key's anchor, 5d8f"


def _mutated(body: bytes, dice: random.Random) -> bytes:
    """A file with some bytes changed: where HDF5 keeps its structure, or anywhere."""
    changed = bytearray(body)
    for _ in range(dice.choice((0, 0, 1, 3, 30))):
        reach = len(changed) if dice.random() < 0.5 else min(4096, len(changed))
        changed[dice.randrange(reach)] = dice.randrange(256)
    if dice.random() < 0.1:
        del changed[dice.randrange(len(changed)) :]
    return bytes(changed)


def _json_bomb(dice: random.Random) -> bytes:
    """A body that is small and means much, or is deep, long or of wild numbers."""
    size = dice.choice((100, 10_000, 300_000))
    return dice.choice(
        (
            b'{"epochs":[' + b",".join([b"1"] * size) + b"]}",
            b"[" * size,
            b'{"epochs":' * size,
            b'{"epochs":[{"epoch":0,"time_s":0,"anchors":{"a":{"delay_s":[' + b"1," * size + b"1]}}}]}",
            b'{"epochs":[{"epoch":' + b"9" * size + b"}]}",
            b"{" + b",".join(b'"k%d":{}' % i for i in range(size // 10)) + b"}",
            b'{"name":"' + b"\\u0000" * size + b'"}',
        )
    )


@pytest.fixture
def walk_file(tmp_path: Path) -> Callable[[], Path]:
    """Makes a good measurement file anew."""
    paths = AnchorPaths(np.full(3, 1e-7), np.full(3, 1e-9), np.full(3, -90.0))
    epochs = tuple(Epoch(i, float(i), (paths, paths)) for i in range(40))
    walls = (GaussianVrp(np.array([8.0, 0.0]), 0.01 * np.eye(2)),)
    measurements = MeasurementSet(("one", "two"), walls, epochs, 28e9)
    return lambda: measurement_file(measurements, tmp_path)


def _channels() -> bytes:
    """Good channels of two anchors, as npz."""
    tones, stream = np.arange(64) * 1e6, io.BytesIO()
    cfr = 1e-4 * np.exp(-2j * np.pi * tones * 1e-7) * np.ones((2, 2, 1, 1))
    axes = {"time_s": np.arange(2.0), "epoch": np.arange(2), "anchor": np.array(["one", "two"])}
    np.savez(stream, cfr_re=cfr.real, cfr_im=cfr.imag, tone_offset_hz=tones, **axes)
    return stream.getvalue()


def _requests(
    makers: dict[str, bytes], count: int, session: str, dice: random.Random
) -> Iterator[tuple[str, bytes, str]]:
    """Addresses, bodies and their types."""
    names = sorted(makers)
    for number in range(count):
        leaf = dice.choice(("uploads", "datasets", "channels", "sweeps", "epochs", "truth", "sessions"))
        path = f"/v1/{leaf}" if leaf in ("uploads", "sessions") else f"/v1/sessions/{session}/{leaf}"
        if leaf in ("epochs", "truth", "sessions"):
            yield path, _json_bomb(dice), "application/json"
        else:
            body = makers[names[number % len(names)]]
            query = "?noise_variance=1" if leaf in ("channels", "sweeps") else ""
            yield f"{path}{query}", _mutated(body, dice), "application/octet-stream"


def _await_readers(url: str, theirs: dict[str, str], file: Path) -> None:
    """Wait until files are read: on a new machine the engine is compiled first, which takes memory."""
    headers = {"Content-Type": "application/octet-stream", **theirs}
    with httpx2.Client(base_url=url, headers=headers, timeout=150.0) as client:
        while (made := client.post("/v1/uploads", content=file.read_bytes())).status_code == 429:
            time.sleep(1.0)
        assert made.status_code == 201, made.text


def test_hostile_files_get_nothing_and_stop_nobody(
    database: str,
    walk_file: Callable[[], Path],
    tmp_path: Path,
    record_property: Callable[[str, Any], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No byte of another file or key comes back, no 5xx but 503, no process grows, the server lives on."""
    monkeypatch.setenv("HAPSLAM_MAX_WORK_S_PER_MINUTE", "100000")  # here everything is to be tried
    with opened(load_settings(database_url=database).url, 5.0) as engine:
        victim, stranger = (KeyRing(engine).create(name) for name in ("victim", "stranger"))
    theirs = {"Authorization": f"Bearer {stranger}"}
    dice = random.Random(HOSTILE)
    canary = tmp_path / "canary.bin"
    canary.write_bytes(CANARY * 200_000)
    makers = {name: make(walk_file(), canary) for name, make in (REACHING | BOMBS).items()}
    statuses: dict[int, int] = {}
    with Server(database, workers=1) as server, Client(server.url, stranger) as friend:
        with Client(server.url, victim) as other:
            other.create_session({"anchors": [_SECRET], "carrier_hz": 28e9})
        session = friend.create_session({"anchors": ["one", "two"], "carrier_hz": 28e9})
        _await_readers(server.url, theirs, walk_file())
        requests = httpx2.Client(base_url=server.url, headers=theirs, timeout=150.0)
        with Watcher(server) as watcher, requests as client:
            for path, body, kind in _requests(makers, HOSTILE, session, dice):
                method = "PUT" if path.endswith("/truth") else "POST"
                answer = client.request(method, path, content=body, headers={"Content-Type": kind})
                while answer.status_code == 429:  # a worker that was replaced is still starting
                    time.sleep(1.0)
                    answer = client.request(method, path, content=body, headers={"Content-Type": kind})
                statuses[answer.status_code] = statuses.get(answer.status_code, 0) + 1
                assert answer.status_code < 500 or answer.status_code == 503, (path, answer.text)
                told = answer.content
                for leaf in ("measurements", "state") if answer.status_code < 300 else ():
                    told += client.get(f"/v1/sessions/{session}/{leaf}").content
                assert CANARY not in told
                assert _SECRET.encode() not in told
                if (made := answer.headers.get("Location")) is not None:
                    told = client.get(f"{made}/measurements").content + client.get(made).content
                    assert CANARY not in told
                    client.delete(made)
        assert friend.session(session)["id"] == session
        good, binary = walk_file(), {"Content-Type": "application/octet-stream", **theirs}
        with httpx2.Client(base_url=server.url, headers=binary, timeout=150.0) as client:
            made = client.post("/v1/uploads", content=good.read_bytes())
            assert made.status_code == 201, made.text
            sent = client.post(f"/v1/sessions/{session}/channels?noise_variance=1e-12", content=_channels())
            assert sent.status_code in (200, 422), sent.text  # 422: no wall was sensed at the start
            assert "reader failed" not in sent.text
    seen = watcher.seen
    waits, idle_s = np.array(seen.waits_s), max(seen.idle_waits_s)
    record_property("answers", json.dumps(statuses, sort_keys=True))
    record_property("slowest /livez, ms", f"{1e3 * waits.max():.0f} of {len(waits)}")
    record_property("slowest answer of an idle process meanwhile, ms", f"{1e3 * idle_s:.0f}")
    record_property("largest process, MiB", f"{seen.most_mib:.0f}")
    assert seen.most_mib < _MOST_MIB
    assert waits.max() < max(_LIVE_S, 2.0 * idle_s)
