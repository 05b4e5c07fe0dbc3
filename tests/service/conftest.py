"""A small walk through a room, and the service around a database of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response

from estimator.measurements import Epoch, MeasurementSet
from estimator.result import SlamResult
from estimator.simulate import SimulationConfig, measure_scene
from estimator.slam import run_slam
from service.api.app import create_app
from service.api.telemetry import configure_logs
from service.settings import load_settings

SEED = 4


@pytest.fixture(scope="session")
def walk() -> MeasurementSet:
    """Forty epochs in a rectangular room with two anchors."""
    corners = np.array([(0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (0.0, 20.0)])
    track = np.stack([np.linspace(6.0, 24.0, 40), 5.0 + 4.0 * np.sin(np.linspace(0, 2.5, 40))], axis=1)
    return measure_scene(
        corners,
        np.roll(corners, -1, axis=0),
        np.array([(25.0, 15.0), (4.0, 17.0)]),
        track,
        (0.1, 0.1, 0.1),
        28e9,
        SimulationConfig(range_std_m=0.05, region_m=60.0),
        np.random.default_rng(SEED),
    )


@pytest.fixture(scope="session")
def reference(walk: MeasurementSet) -> SlamResult:
    """The walk as the batch command estimates it."""
    return run_slam(walk, seed=SEED)


@pytest.fixture(scope="session")
def make_request(walk: MeasurementSet) -> Callable[..., dict[str, Any]]:
    """The body that makes a session for the walk."""

    def make(**more: Any) -> dict[str, Any]:
        return {
            "name": "walk",
            "seed": SEED,
            "anchors": list(walk.anchors),
            "carrier_hz": walk.carrier_hz,
            "measurement_model": walk.settings["measurement_model"],
            **more,
        }

    return make


@pytest.fixture(scope="session")
def sweep_request(walk: MeasurementSet) -> Callable[[], dict[str, Any]]:
    """The body that gives a session the walk's walls."""

    def make() -> dict[str, Any]:
        return {
            "sweep": 0,
            "walls": [
                {"vrp_m": wall.mean_m.tolist(), "covariance_m2": wall.covariance_m2.tolist()}
                for wall in walk.walls
            ],
        }

    return make


@pytest.fixture(scope="session")
def epochs_request(walk: MeasurementSet) -> Callable[[int, int], dict[str, Any]]:
    """The body with a range of the walk's epochs."""

    def entry(epoch: Epoch) -> dict[str, Any]:
        anchors = {
            name: {"delay_s": paths.delay_s.tolist(), "delay_std_s": paths.delay_std_s.tolist()}
            for name, paths in zip(walk.anchors, epoch.paths, strict=True)
        }
        return {"epoch": epoch.index, "time_s": epoch.time_s, "anchors": anchors}

    return lambda first, last: {"epochs": [entry(epoch) for epoch in walk.epochs[first:last]]}


@pytest.fixture(autouse=True)
def _plain_logs() -> None:
    """Logs as the server writes them."""
    configure_logs()


@pytest.fixture
def database(tmp_path: Path) -> str:
    """A database of the test's own."""
    return f"sqlite:///{tmp_path / 'hapslam.db'}"


@pytest.fixture
def client(database: str) -> Iterator[TestClient]:
    """The service, stepping in its own process."""
    app = create_app(load_settings(database_url=database, workers=0))
    with TestClient(app, base_url="http://localhost", client=("127.0.0.1", 50000)) as client:
        yield client


@pytest.fixture
def make_session(
    client: TestClient, make_request: Callable[..., Any], sweep_request: Callable[[], Any]
) -> Callable[..., str]:
    """Makes a session, with the walk's walls unless told otherwise."""

    def make(sweep: bool = True, **more: Any) -> str:
        created = client.post("/v1/sessions", json=make_request(**more))
        assert created.status_code == 201, created.text
        url = str(created.headers["Location"])
        if sweep:
            assert client.post(f"{url}/sweeps", json=sweep_request()).status_code == 200
        return url

    return make


@pytest.fixture
def session_url(make_session: Callable[..., str]) -> str:
    """A session that has its walls and no epoch."""
    return make_session()


@pytest.fixture
def post_epochs(client: TestClient, epochs_request: Callable[[int, int], Any]) -> Callable[..., Response]:
    """Posts a range of the walk's epochs to a session."""
    return lambda url, first, last: client.post(f"{url}/epochs", json=epochs_request(first, last))
