"""Requests that no one would write by hand: generated from the schema, and bodies broken at random."""

from __future__ import annotations

import io
import json
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet
from service.api.app import create_app
from service.api.telemetry import configure_logs
from service.client import Client, UnexpectedAnswerError
from service.messages.requests import epoch_entry, session_entry, sweep_entry
from service.settings import load_settings
from tests.service.harness import Server

BODIES = int(os.environ.get("HAPSLAM_TEST_BODIES", "200"))
_LIMITS = {"max_body_bytes": 2**20, "max_unpacked_bytes": 2**26}
_PEAK_MIB = 512.0  # how far above its start memory may rise: some copies of what may be unpacked
EXAMPLES = int(os.environ.get("HAPSLAM_TEST_EXAMPLES", "5"))


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FastAPI]:
    """One running application for all generated requests, with a session in it."""
    configure_logs()
    file = tmp_path_factory.mktemp("fuzz") / "hapslam.db"
    application = create_app(load_settings(database_url=f"sqlite:///{file}", workers=0, **_LIMITS))
    with TestClient(application, base_url="http://localhost", client=("127.0.0.1", 5000)):
        yield application


_BINARY = {"Content-Type": "application/octet-stream"}

# A schema cannot say all that a body must be (columns of equal length, covariances, whole files); what is
# not so is 422.
_CONFIG = """
[checks.positive_data_acceptance]
expected-statuses = ["2xx", "401", "403", "404", "409", "413", "422", "429"]

[[operations]]
include-path-regex = "/events$"
parameters = {{ follow = false }}

[parameters]
{parameters}
"""


@pytest.mark.parametrize("phases", ["examples,coverage,stateful", "fuzzing"])
def test_answers_are_as_described(database: str, walk: MeasurementSet, phases: str, tmp_path: Path) -> None:
    """Schemathesis with all its checks, on all routes of a running server, finds nothing.

    It sends what the schema gives as examples, what lies at its limits and beyond, sequences in which a
    request uses what another was answered; and, to a session that has epochs, what is drawn at random.
    """
    program, config = Path(sys.executable).with_name("schemathesis"), tmp_path / "schemathesis.toml"
    options = [
        *f"--phases {phases} --checks all --max-examples {EXAMPLES} --seed 1 --request-timeout 60".split(),
        *("--exclude-path-regex", "/epochs/stream$"),  # lines, which it cannot make; see test_streams.py
    ]
    log = tmp_path / "server.log"
    with Server(database, log=log) as server, Client(server.url) as client:
        session = client.create_session(session_entry(walk))
        client.post_sweep(session, sweep_entry(walk))
        client.post_epochs(session, [epoch_entry(walk.anchors, epoch) for epoch in walk.epochs[:5]])
        with pytest.raises(UnexpectedAnswerError, match="expected a netCDF-4"):  # once files are read
            client.request("POST", "/v1/uploads", content=b"rubbish", headers=_BINARY)
        known = ""
        if phases == "fuzzing":
            known, options = f'session_id = "{session}"', [*options, "--exclude-method", "DELETE"]
        config.write_text(_CONFIG.format(parameters=known))
        finished = subprocess.run(
            [program, "--config-file", config, "run", f"{server.url}/openapi.json", *options],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert finished.returncode == 0, finished.stdout[-20_000:]
        selected = 32 if phases == "fuzzing" else 33
        assert f"{selected} selected / 34 total" in finished.stdout
        if phases == "fuzzing" or session not in _deleted(log):
            assert client.session(session)["next_epoch"] >= 5


def _deleted(log: Path) -> set[str]:
    """Sessions that someone asked the server to delete, and it did: a sequence may find one in the list."""
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    gone = [one["path"] for one in lines if one.get("method") == "DELETE" and one.get("status") == 204]
    return {path.rpartition("/")[2] for path in gone}


def _mutants(seeds: list[bytes], rng: random.Random) -> Iterator[bytes]:
    """Broken copies: cut, with bytes flipped, doubled, spliced, far too long, or with wild numbers."""
    words = [b"NaN", b"Infinity", b"-1e999", b"1e308", b"null", b'"\\ud800"', b"[" * 500, b"{}", b"9" * 400]
    while True:
        body = bytearray(rng.choice(seeds))
        for _ in range(rng.randint(1, 4)):
            kind, at = rng.randrange(7), rng.randrange(len(body) + 1)
            if kind == 0:
                del body[at:]
            elif kind == 1 and body:
                for _ in range(rng.randint(1, 20)):
                    body[rng.randrange(len(body))] = rng.randrange(256)
            elif kind == 2:
                body[at:at] = body[: rng.randrange(200)]
            elif kind == 3:
                body[at : at + rng.randrange(40)] = rng.choice(words)
            elif kind == 4:
                body[at:at] = rng.randbytes(rng.randrange(100))
            elif kind == 5 and rng.random() < 0.1:
                body += body[-1:] * _LIMITS["max_body_bytes"]
            else:
                del body[at : at + rng.randrange(100)]
            if not body:
                break
        yield bytes(body)


# h5netcdf's file object complains when it is collected after it could not be opened
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("route", ["epochs", "sweeps", "sessions", "channels", "datasets", "uploads"])
def test_broken_bodies_never_break_the_service(
    app: FastAPI,
    walk: MeasurementSet,
    make_request: Callable[..., Any],
    sweep_request: Callable[[], Any],
    epochs_request: Callable[..., Any],
    tmp_path: Path,
    route: str,
) -> None:
    """Bodies broken at random get an answer that is no 5xx; what is whole is still taken in."""
    client = TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000))
    rng = random.Random(route)
    url = client.post("/v1/sessions", json=make_request()).headers["Location"]
    save_measurements(walk, tmp_path / "walk.nc")
    stream = io.BytesIO()
    shape = (2, 2, 1, 16)
    np.savez_compressed(
        stream,
        cfr_re=np.ones(shape),
        cfr_im=np.ones(shape),
        time_s=np.arange(2.0),
        epoch=np.arange(2),
        anchor=np.array(walk.anchors),
        tone_offset_hz=np.arange(16) * 1e5,
    )
    bomb = io.BytesIO()
    np.savez_compressed(bomb, cfr_re=np.zeros(2 * _LIMITS["max_unpacked_bytes"] // 8))
    files = [stream.getvalue(), (tmp_path / "walk.nc").read_bytes(), bomb.getvalue()]
    json_type, binary = "application/json", "application/octet-stream"
    seeds, path, content_type = {
        "epochs": ([json.dumps(epochs_request(0, 2)).encode()], f"{url}/epochs", json_type),
        "sweeps": ([json.dumps(sweep_request()).encode()], f"{url}/sweeps", json_type),
        "sessions": ([json.dumps(make_request()).encode()], "/v1/sessions", json_type),
        "channels": (files, f"{url}/channels?noise_variance=1", binary),
        "datasets": (files, f"{url}/datasets", binary),
        "uploads": (files, "/v1/uploads", binary),
    }[route]
    mutants = _mutants(seeds, rng)
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak of memory so far
    start_mib = _memory_mib("VmRSS")
    for _ in range(-(-BODIES // 6)):
        body = next(mutants)
        answer = client.post(path, content=body, headers={"Content-Type": content_type})
        assert answer.status_code < 500, (answer.status_code, answer.text, body[:2000])
    assert client.post("/v1/sessions", json=make_request()).status_code == 201
    assert _memory_mib("VmHWM") - start_mib < _PEAK_MIB


def _memory_mib(entry: str) -> float:
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith(entry)) / 1024
