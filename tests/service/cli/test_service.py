"""The service's commands as an operator types them."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from estimator.errors import ConfigurationError
from estimator.measurement_files import save_measurements
from estimator.measurements import MeasurementSet
from service.bench.load import LoadConfig, measure_load
from service.bench.memory import measure_memory
from service.client import Client
from service.settings import load_settings
from tests.service.harness import Server


def test_keys_are_made_listed_and_revoked(main: Callable[..., Any], database: str) -> None:
    """A key is shown once, the list never shows it, and what is revoked says since when."""
    made = main("key", "create", "ann", "--database", database)
    key = made.out.strip()
    assert (made.status, key[:8]) == (0, "hapslam_")
    listed = main("key", "list", "--database", database)
    key_id = listed.out.split()[0]
    assert key_id in key
    assert key not in listed.out
    assert "in force" in listed.out
    assert main("key", "revoke", key_id, "--database", database).status == 0
    assert "revoked" in main("key", "list", "--database", database).out
    again = main("key", "revoke", key_id, "--database", database)
    assert (again.status, "expected the id of a key in force" in again.err) == (2, True)


def test_serving_elsewhere_without_keys_is_refused(main: Callable[..., Any], database: str) -> None:
    """One line that names the remedy, status 2, nothing listens."""
    refused = main("serve", "--host", "0.0.0.0", "--port", 0, "--database", database)
    assert refused.status == 2
    assert "hapslam key create" in refused.err
    assert refused.err.count("\n") == 1


def test_push_and_verify(
    main: Callable[..., Any], database: str, walk: MeasurementSet, tmp_path: Path
) -> None:
    """A pushed file is verified; a database changed behind the service's back is not."""
    file = tmp_path / "walk.nc"
    save_measurements(walk, file)
    with Server(database) as server:
        pushed = main("push", file, "--url", server.url, "--seed", 4, "--quiet")
        assert pushed.status == 0, pushed.err
        assert "40, 40 of them new" in pushed.out
        session = pushed.out.split()[1]
        again = main("push", file, "--url", server.url, "--session", session, "--quiet")
        assert "40, 0 of them new" in again.out
        with Client(server.url) as client:
            assert client.session(session)["name"] == "walk"
        assert server.stop() == 0
    good = main("service", "verify", "--database", database, "--quiet")
    assert (good.status, good.out) == (0, "1 sessions, 40 epochs, 0 differences\n")
    with sqlite3.connect(database.removeprefix("sqlite:///")) as raw:
        raw.execute("UPDATE estimates SET document = replace(document, '1', '2') WHERE epoch = 39")
    bad = main("service", "verify", "--database", database, "--quiet")
    assert bad.status == 1
    assert f"{session}: the estimates differ from epoch 39 on" in bad.out


def test_pushing_to_no_one_is_one_line(
    main: Callable[..., Any], walk: MeasurementSet, tmp_path: Path
) -> None:
    """A wrong address ends with status 2 and says what was expected."""
    file = tmp_path / "walk.nc"
    save_measurements(walk, file)
    wrong = main("push", file, "--url", "localhost:1", "--quiet")
    assert wrong.status == 2
    assert "expected an address like" in wrong.err


def test_settings_come_from_file_and_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arguments win over the environment, the environment over the file, the file over defaults."""
    file = tmp_path / "service.toml"
    file.write_text('port = 9001\nworkers = 3\nhost = "::1"\n')
    monkeypatch.setenv("HAPSLAM_WORKERS", "5")
    settings = load_settings(file, port=9002)
    assert (settings.port, settings.workers, settings.host) == (9002, 5, "::1")
    monkeypatch.setenv("HAPSLAM_CONFIG", str(file))
    assert load_settings().port == 9001
    monkeypatch.setenv("HAPSLAM_WORKERS", "many")
    with pytest.raises(ConfigurationError, match="workers"):
        load_settings()
    monkeypatch.delenv("HAPSLAM_WORKERS")
    file.write_text("colour = 1\n")
    with pytest.raises(ConfigurationError, match="colour"):
        load_settings()
    file.write_text("port = \n")
    with pytest.raises(ConfigurationError, match="TOML"):
        load_settings()
    monkeypatch.delenv("HAPSLAM_CONFIG")
    with pytest.raises(ConfigurationError, match="database_url"):
        load_settings(database_url="mysql://somewhere/else")


@pytest.mark.soak
def test_the_load_test_runs(database: str) -> None:
    """A short load: every request is answered well, and the figures are there."""
    figures = measure_load(LoadConfig(sessions=10, seconds=5.0, rate_hz=40.0, workers=1), database)
    assert figures["errors"] == 0
    assert figures["epochs_per_s"] > 5.0
    assert figures["nothing_per_s"] > figures["epochs_per_s"]
    json.dumps(figures, allow_nan=False)


@pytest.mark.soak
def test_memory_is_measured() -> None:
    """Epochs go to a server of its own; its memory and that of its worker are seen, and do not explode."""
    use = measure_memory(1_600, workers=1)
    assert use.epochs == 1_600
    assert 100.0 < use.warm_mib < 1000.0
    assert use.growth_mib < 64.0


def seconds_of_libraries() -> float:
    """What the libraries that a server cannot do without take to import here, in a process of their own."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import fastapi, uvicorn, sqlalchemy, numpy"], check=True)
    return time.perf_counter() - begin


@pytest.fixture
def no_ray_tracer(tmp_path: Path) -> Path:
    """A folder which, first in the path, keeps Mitsuba, Dr.Jit and Sionna from being imported."""
    for name in ("mitsuba", "drjit", "sionna"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('not installed here')\n")
    return tmp_path


def test_the_service_needs_no_ray_tracer(database: str, no_ray_tracer: Path) -> None:
    """Where Mitsuba, Dr.Jit and Sionna cannot be imported the service starts and answers."""
    with Server(database, path=(no_ray_tracer,)) as server, Client(server.url) as client:
        assert list(client.sessions()) == []


@pytest.mark.soak
def test_the_service_starts_soon(database: str, no_ray_tracer: Path) -> None:
    """It is ready within 2 s, at the best of tries.

    On a machine so slow that its libraries alone take more than half a second, within four times that.
    """
    taken, libraries = [], []
    for _ in range(5):
        libraries.append(seconds_of_libraries())
        with Server(database, path=(no_ray_tracer,)) as server:
            taken.append(server.start_s)
        if taken[-1] < 2.0:
            break
    assert min(taken) < max(2.0, 4.0 * min(libraries))
