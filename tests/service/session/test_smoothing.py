"""A session given all of its measurements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.slam.smoothing.refine import RefineConfig, refine
from service.api.app import create_app
from service.settings import load_settings


def test_a_session_is_smoothed_as_the_batch_run_is(
    client: TestClient,
    walk: MeasurementSet,
    reference: SlamResult,
    make_session: Callable[..., str],
    post_epochs: Callable[..., Any],
) -> None:
    """Track and map are those of the smoother on the batch result, bit for bit; surer than the filter."""
    url = make_session(start_frame={"position_m": [6.0, 5.0], "heading_rad": 0.0})
    post_epochs(url, 0, 40)
    for lag in (0, 5):
        expected = refine(walk, reference, config=RefineConfig(lag=lag))
        found = client.get(f"{url}/smoothed", params={"lag": lag}).json()
        track = found["trajectory"]
        assert track["epoch"] == list(range(40))
        assert track["y_m"] == expected.agent_mean[:, 1].tolist()
        assert track["variance_x_m2"] == expected.agent_covariance[:, 0, 0].tolist()
    assert found["map"]["frame"] == "plan"
    assert len(found["map"]["walls"]) == expected.wall_valid[-1].sum() >= 3
    whole = client.get(f"{url}/smoothed").json()["trajectory"]
    filtered = client.get(f"{url}/trajectory").json()
    middle = slice(5, 30)
    assert np.all(np.array(whole["variance_x_m2"][middle]) < np.array(filtered["variance_x_m2"][middle]))
    assert client.get(f"{url}/state").json()["epoch"] == 39


def test_what_cannot_be_smoothed_is_told(
    database: str,
    client: TestClient,
    make_session: Callable[..., str],
    post_epochs: Callable[..., Any],
) -> None:
    """No epoch: 409; no wall sensed at the start: 422; longer than the operator allows: 413."""
    empty, bare = make_session(), make_session(sweep=False)
    assert client.get(f"{empty}/smoothed").status_code == 409
    epochs = [{"epoch": n, "time_s": float(n), "anchors": {}} for n in range(3)]
    assert client.post(f"{bare}/epochs", json={"epochs": epochs}).status_code == 422
    wall = {"vrp_m": [20.0, 0.0], "covariance_m2": [[0.01, 0.0], [0.0, 0.01]]}
    client.post(f"{bare}/sweeps", json={"walls": [wall]})
    assert client.post(f"{bare}/epochs", json={"epochs": epochs}).status_code == 200
    silent = client.get(f"{bare}/smoothed")
    assert silent.status_code in (200, 422), silent.text
    app = create_app(load_settings(database_url=database, workers=0, max_smoothed_epochs=2))
    with TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000)) as strict:
        refused = strict.get(f"{bare}/smoothed")
    assert refused.status_code == 413
    assert "at most 2 epochs" in refused.json()["detail"]
