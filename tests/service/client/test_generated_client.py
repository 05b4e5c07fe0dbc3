"""A typed client made from the interface's description drives a session; the description is whole."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from estimator.slam.gaussian.config import GaussianConfig
from service.client import Client
from tests.service.harness import Server


@pytest.fixture
def document(client: TestClient) -> dict[str, Any]:
    """The interface's description."""
    found: dict[str, Any] = client.get("/openapi.json").json()
    return found


@pytest.fixture
def generated(document: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The client's package, made by openapi-python-client."""
    file = tmp_path / "openapi.json"
    file.write_text(json.dumps(document), encoding="utf-8")
    config = tmp_path / "config.yaml"
    config.write_text("post_hooks: []\n", encoding="utf-8")
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
    places = [
        "--path",
        str(file),
        "--output-path",
        str(tmp_path / "generated_hapslam"),
        "--config",
        str(config),
    ]
    done = subprocess.run([*command, *places], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    missing = [line for line in done.stdout.splitlines() if "will not be generated" in line]
    assert [line.split()[2] for line in missing if "epochs/stream" not in line] == []
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "generated_hapslam"
    for name in [name for name in sys.modules if name.startswith("generated_hapslam")]:
        del sys.modules[name]


def test_a_generated_client_drives_a_session(
    database: str,
    generated: str,
    make_request: Callable[..., Any],
    sweep_request: Callable[[], Any],
    epochs_request: Callable[[int, int], Any],
) -> None:
    """Make, sense, measure, rename, read, delete: with types all the way, and problems as such."""

    def part(name: str) -> Any:
        return importlib.import_module(f"{generated}.{name}")

    models = part("models")
    with Server(database) as server, part("client").Client(base_url=server.url, timeout=60.0) as client:
        with Client(server.url) as patient:  # waits until the workers are ready
            first = patient.create_session(make_request())
            patient.post_sweep(first, sweep_request())
            patient.post_epochs(first, epochs_request(0, 1)["epochs"])
            patient.map(first)
        made = part("api.sessions.create_session").sync(
            client=client, body=models.SessionRequest.from_dict(make_request())
        )
        assert isinstance(made, models.Session)
        assert "post a sweep before epoch 0" in made.warnings[0]
        sweep = models.SweepRequest.from_dict(sweep_request())
        part("api.measurements.sweeps").sync(made.id, client=client, body=sweep)
        body = models.EpochsRequest.from_dict(epochs_request(0, 6))
        answer = part("api.measurements.epochs").sync(made.id, client=client, body=body)
        assert isinstance(answer, models.EpochsAnswer)
        state = part("api.state.state").sync(made.id, client=client)
        assert state.to_dict() == answer.state.to_dict()
        assert state.walls[0].existence > 0.5
        found = part("api.state.map_").sync(made.id, client=client)
        assert len(found.track_m) == 6
        change = models.SessionChange.from_dict({"name": "renamed"})
        assert part("api.sessions.change_session").sync(made.id, client=client, body=change).name == "renamed"
        wrong = part("api.state.state").sync(made.id, client=client, epoch=99)
        assert isinstance(wrong, models.Problem)
        assert wrong.status == 409
        part("api.sessions.delete_session").sync_detailed(made.id, client=client)
        assert isinstance(part("api.sessions.read_session").sync(made.id, client=client), models.Problem)


def test_the_description_is_whole(document: dict[str, Any]) -> None:
    """Keys, times to come again, and every setting of the noise model with what it means are described."""
    schemas, paths = document["components"]["schemas"], document["paths"]
    assert document["components"]["securitySchemes"]["key"]["scheme"] == "bearer"
    assert {"key": []} in document["security"]
    assert paths["/livez"]["get"]["security"] == []
    busy = paths["/v1/sessions"]["post"]["responses"]["429"]
    assert "Retry-After" in busy["headers"]
    assert busy["content"]["application/problem+json"]["schema"]["$ref"].endswith("/Problem")
    settings = schemas["SessionRequest"]["properties"]["measurement_model"]["properties"]
    numbers = {name for name, value in GaussianConfig().flat().items() if isinstance(value, (int, float))}
    assert {name for name in numbers if not isinstance(GaussianConfig().flat()[name], bool)} == set(settings)
    undescribed = [name for name, entry in settings.items() if len(entry["description"].split()) < 2]
    assert undescribed == []
    for path, operations in paths.items():
        for method, operation in operations.items():
            done = next(answer for status, answer in operation["responses"].items() if status.startswith("2"))
            assert operation["summary"], path
            assert method == "delete" or done["description"], path
    assert "TS 38.455" in schemas["NrppaReport"]["description"]
    assert "TS 37.355" in schemas["LppReport"]["description"]
    assert "NR-Multi-RTT-MeasElement-r16" in schemas["NrMultiRttMeasElement"]["description"]


@pytest.mark.parametrize(
    ("path", "name"), [("state", "epcoh"), ("map", "fromat"), ("trajectory", "from"), ("events", "follows")]
)
def test_unknown_parameters_are_refused(client: TestClient, session_url: str, path: str, name: str) -> None:
    """A misspelt parameter is told, with those that there are."""
    answer = client.get(f"{session_url}/{path}?{name}=1")
    assert answer.status_code == 422
    assert f"got '{name}'" in answer.json()["detail"]
    assert "expected one of" in answer.json()["detail"]


def test_anchors_may_be_added_at_any_time(
    client: TestClient, make_session: Callable[..., str], epochs_request: Callable[[int, int], Any]
) -> None:
    """So may the name change; the anchors that are there stay, and the epochs taken in."""
    url = make_session()
    anchors = client.get(url).json()["anchors"]
    wrong = client.patch(url, json={"anchors": [*reversed(anchors), "pa9"]})
    assert wrong.status_code == 422
    assert "first, in this order" in wrong.json()["detail"]
    added = client.patch(url, json={"anchors": [*anchors, "pa9"], "name": "three"}).json()
    assert (added["anchors"], added["name"]) == ([*anchors, "pa9"], "three")
    state = client.post(f"{url}/epochs", json=epochs_request(0, 3)).json()["state"]
    assert [anchor["name"] for anchor in state["anchors"]] == [*anchors, "pa9"]
    late = client.patch(url, json={"anchors": [*anchors, "pa9", "pa10"]})
    assert late.status_code == 200, late.text
    state = client.get(f"{url}/state").json()
    assert [anchor["name"] for anchor in state["anchors"]] == [*anchors, "pa9", "pa10"]
    assert state["epoch"] == 2
    assert client.patch(url, json={"name": "again"}).json()["name"] == "again"
    assert client.post(f"{url}/epochs", json=epochs_request(3, 5)).status_code == 200
