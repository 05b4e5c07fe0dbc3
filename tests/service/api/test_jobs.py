"""Files as jobs: answered at once, taken in once, whatever happens to the server meanwhile."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from fastapi import FastAPI
from fastapi.testclient import TestClient

from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult, load_result
from service.client import Client
from service.errors import TooManyError
from service.settings import load_settings
from service.storage.database import opened
from service.storage.jobs import JobStore, JobTerms
from service.storage.store import Store
from service.storage.tables import job_parts, jobs
from tests.service.harness import SEED, Server

KILLS = int(os.environ.get("HAPSLAM_TEST_KILLS", "2"))
_BINARY = {"Content-Type": "application/octet-stream", "Prefer": "respond-async"}


@pytest.fixture
def file(walk: MeasurementSet, tmp_path: Path) -> bytes:
    """The walk as a measurement file."""
    save_measurements(walk, tmp_path / "walk.nc")
    return (tmp_path / "walk.nc").read_bytes()


def _done(client: Any, location: str, patience_s: float = 60.0) -> dict[str, Any]:
    """A job once it is done or has failed."""
    end = time.monotonic() + patience_s
    while (job := client.get(location).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.05)
    return dict(job)


def test_an_upload_is_answered_at_once_and_taken_in_later(
    client: TestClient, file: bytes, reference: SlamResult
) -> None:
    """The job ends with the session, its states are those of the batch command; again it is the same job."""
    headers = {**_BINARY, "Idempotency-Key": "walk"}
    path = f"/v1/uploads?name=walk&seed={SEED}"
    sent = client.post(path, content=file, headers=headers)
    assert sent.status_code == 202, sent.text
    assert (sent.headers["Preference-Applied"], sent.json()["kind"]) == ("respond-async", "upload")
    job = _done(client, sent.headers["Location"])
    assert job["state"] == "done", job
    track = client.get(f"/v1/sessions/{job['session']}/trajectory").json()
    assert np.array_equal(track["x_m"], reference.agent_mean[:, 0])
    again = client.post(path, content=file, headers=headers).json()
    assert (again["id"], again["session"]) == (job["id"], job["session"])
    assert len(client.get("/v1/sessions").json()["sessions"]) == 1
    assert [entry["id"] for entry in client.get("/v1/jobs").json()["jobs"]] == [job["id"]]
    app = client.app
    assert isinstance(app, FastAPI)
    with app.state.context.store.reading() as connection:
        assert connection.execute(sa.select(sa.func.count()).select_from(job_parts)).scalar_one() == 0


def test_a_dataset_goes_to_its_session_and_a_bad_file_tells_why(
    client: TestClient, make_session: Callable[..., str], file: bytes
) -> None:
    """A job of a session takes epochs into it; what cannot be read fails with the problem of a request."""
    url = make_session(sweep=False)
    good = _done(client, client.post(f"{url}/datasets", content=file, headers=_BINARY).headers["Location"])
    assert (good["state"], good["last_epoch"]) == ("done", 39)
    assert client.get(url).json()["next_epoch"] == 40
    bad = _done(client, client.post("/v1/uploads", content=b"rubbish", headers=_BINARY).headers["Location"])
    assert bad["state"] == "failed"
    assert bad["problem"]["status"] == 422
    assert "expected a netCDF-4 measurement file" in bad["problem"]["detail"]
    nowhere = client.post(f"/v1/sessions/{'0' * 32}/datasets", content=file, headers=_BINARY)
    assert nowhere.status_code == 404
    assert client.get(f"/v1/jobs/{'0' * 32}").status_code == 404


def test_a_lease_that_ran_out_is_anothers(database: str) -> None:
    """A job is one process's at a time; when its lease has run out the next one has it, and limits hold."""
    with opened(load_settings(database_url=database).url, 5.0) as engine:
        store = JobStore(Store(engine), JobTerms(lease_s=5.0))
        body = random.Random(1).randbytes(3 * 2**20 + 17)
        store.submit("a" * 32, None, "upload", "{}", body, 2)
        store.submit("b" * 32, None, "upload", "{}", b"", 2)
        with pytest.raises(TooManyError, match="at most 2 jobs"):
            store.submit("c" * 32, None, "upload", "{}", b"", 2)
        first, second = store.claim(), store.claim()
        assert first is not None
        assert second is not None
        assert [first.id[0], second.id[0]] == ["a", "b"]
        assert store.body(first.id) == body
        assert store.claim() is None
        with engine.begin() as connection:
            past = datetime.now(UTC) - timedelta(seconds=1)
            connection.execute(sa.update(jobs).where(jobs.c.id == first.id).values(leased_until=past))
        again = store.claim()
        assert again is not None
        assert (again.id, again.attempts) == (first.id, 2)
        store.release(again.id)
        assert store.read(again.id, None).state == "queued"
        store.finish(first.id, "done", "{}")
        store.submit(first.id, None, "upload", "{}", body, 2)  # what is done stays so
        assert store.read(first.id, None).state == "done"


def test_jobs_outlive_kills(database: str, file: bytes, reference: SlamResult, tmp_path: Path) -> None:
    """A job whose server is killed at any moment ends with one session, as if nothing had happened."""
    dice, killed = random.Random(KILLS), 0
    server = Server(database)
    server.start()
    try:
        with Client(server.url, attempts=100_000, patience_s=0.2, timeout_s=20.0) as client:
            while killed < KILLS:
                headers = {**_BINARY, "Idempotency-Key": f"job-{killed}"}
                job = client.request("POST", f"/v1/uploads?seed={SEED}", content=file, headers=headers)
                for _ in range(dice.randint(1, 2)):
                    time.sleep(dice.uniform(0.0, 0.6))
                    server.kill()
                    killed += 1
                    server.start()
                end = time.monotonic() + 120.0
                while (found := client.request("GET", f"/v1/jobs/{job['id']}"))["state"] != "done":
                    assert found["state"] != "failed", found
                    assert time.monotonic() < end, found
                    time.sleep(0.1)
                path = tmp_path / f"{job['id']}.nc"
                path.write_bytes(client.export(found["session"]))
                assert np.array_equal(load_result(path).agent_mean, reference.agent_mean)
            sessions = list(client.sessions())
            listed = client.request("GET", "/v1/jobs?limit=500")["jobs"]
            assert len({entry["session"] for entry in listed}) == len(sessions) == len(listed)
    finally:
        server.kill()
