"""Requests that no one would write by hand: generated from the schema, and bodies broken at random."""

from __future__ import annotations

import io
import json
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import schemathesis
from fastapi import FastAPI
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode

from estimator.measurements import MeasurementSet, save_measurements
from service.app import create_app
from service.settings import load_settings
from service.telemetry import configure_logs

BODIES = int(os.environ.get("HAPSLAM_TEST_BODIES", "200"))
EXAMPLES = int(os.environ.get("HAPSLAM_TEST_EXAMPLES", "5"))


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FastAPI]:
    """One running application for all generated requests, with a session in it."""
    configure_logs()
    file = tmp_path_factory.mktemp("fuzz") / "hapslam.db"
    application = create_app(load_settings(database_url=f"sqlite:///{file}", workers=0, max_body_bytes=2**20))
    with TestClient(application, base_url="http://localhost", client=("127.0.0.1", 5000)):
        yield application


@pytest.mark.parametrize("mode", [GenerationMode.POSITIVE, GenerationMode.NEGATIVE])
def test_answers_are_as_described(app: FastAPI, mode: GenerationMode) -> None:
    """Whatever is asked, the answer is one that the OpenAPI document describes, and none is a 5xx."""
    described = schemathesis.openapi.from_asgi("/openapi.json", app)
    asked = 0
    for operation in described.exclude(path_regex="/events|/example").get_all_operations():
        asked += _ask(operation.ok(), mode)
    assert asked > 50


def _ask(operation: Any, mode: GenerationMode) -> int:
    """Send generated requests to an operation and check the answers; how many there were."""
    asked = 0

    @given(case=operation.as_strategy(generation_mode=mode))
    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    def check(case: Any) -> None:
        nonlocal asked
        asked += 1
        case.call_and_validate(base_url="http://localhost")

    try:
        check()
    except Unsatisfiable:  # nothing can be wrong with a request that has no parameters
        return 0
    return asked


def _mutants(seeds: list[bytes], rng: random.Random) -> Iterator[bytes]:
    """Broken copies: cut, with bytes flipped, doubled, spliced, or with wild numbers."""
    words = [b"NaN", b"Infinity", b"-1e999", b"1e308", b"null", b'"\\ud800"', b"[" * 500, b"{}", b"9" * 400]
    while True:
        body = bytearray(rng.choice(seeds))
        for _ in range(rng.randint(1, 4)):
            kind, at = rng.randrange(6), rng.randrange(len(body) + 1)
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
    files = [stream.getvalue(), (tmp_path / "walk.nc").read_bytes()]
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
    for _ in range(BODIES // 6):
        body = next(mutants)
        answer = client.post(path, content=body, headers={"Content-Type": content_type})
        assert answer.status_code < 500, (answer.status_code, answer.text, body[:2000])
    assert client.post("/v1/sessions", json=make_request()).status_code == 201
