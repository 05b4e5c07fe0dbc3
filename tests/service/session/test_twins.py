"""A session's twin over HTTP: a floor plan that predicts channels, and its coverage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient
from PIL import Image

from raytrace.plan.files import load_floorplan
from raytrace.prediction.channels import predict
from raytrace.propagation.coverage import lattice, path_gains
from service.api.app import create_app
from service.settings import load_settings

CORNERS = np.array([(0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (0.0, 20.0)]) - (
    6.0,
    5.0,
)  # from where the walk began
ANCHORS = np.array([(25.0, 15.0), (4.0, 17.0)]) - (6.0, 5.0)


def test_a_twin_is_a_floor_plan_of_the_room(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any], tmp_path: Path
) -> None:
    """Its walls lie on the true ones, its anchors where they stand; the file loads and predicts channels."""
    post_epochs(session_url, 0, 40)
    answer = client.get(f"{session_url}/twin", params={"agent_height_m": 1.2})
    assert answer.status_code == 200, answer.text
    assert answer.headers["Content-Type"].startswith("application/toml")
    assert "attachment" in answer.headers["Content-Disposition"]
    (tmp_path / "twin.toml").write_text(answer.text)
    plan = load_floorplan(str(tmp_path / "twin.toml"))
    assert plan.agent.height_m == 1.2
    assert plan.uncertainty is not None
    sides = np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1)
    for start, end in zip(*plan.walls_m(), strict=True):
        normal = np.array([end[1] - start[1], start[0] - end[0]]) / np.linalg.norm(end - start)
        away = np.abs((sides - start) @ normal).max(axis=1)
        assert away.min() < 0.3  # on the line of one side, both of its corners
    places = np.array([anchor.position_m[:2] for anchor in plan.anchors])
    assert np.linalg.norm(places - ANCHORS[: len(places)], axis=1).max() < 0.3
    assert predict(plan, np.array([[4.0, 3.0]])).power.min() > 0.0


def test_coverage_is_what_the_twin_predicts(
    client: TestClient, session_url: str, post_epochs: Callable[..., Any], tmp_path: Path
) -> None:
    """As JSON, point by point; as a picture with colours in it."""
    post_epochs(session_url, 0, 40)
    found = client.get(f"{session_url}/coverage", params={"step_m": 2.0}).json()
    (tmp_path / "twin.toml").write_text(client.get(f"{session_url}/twin").text)
    plan = load_floorplan(str(tmp_path / "twin.toml"))
    x, y = lattice(plan, 2.0)
    with np.errstate(divide="ignore"):
        gain_db = 10.0 * np.log10(path_gains(plan, x, y).max(axis=-1).T)
    np.testing.assert_allclose(found["x_m"], x)
    np.testing.assert_allclose(found["y_m"], y)
    told = np.array(found["gain_db"], dtype=np.float64)
    assert np.isfinite(told).mean() > 0.5
    np.testing.assert_array_equal(np.isfinite(told), np.isfinite(gain_db))
    np.testing.assert_allclose(told, gain_db, atol=0.006)
    picture = client.get(f"{session_url}/coverage.png", params={"step_m": 2.0})
    assert picture.headers["Content-Type"] == "image/png"
    (tmp_path / "coverage.png").write_bytes(picture.content)
    with Image.open(tmp_path / "coverage.png") as image:
        pixels = np.asarray(image.convert("RGB"), dtype=int).reshape(-1, 3)
    assert np.mean(np.ptp(pixels, axis=1) > 40) > 0.2  # colours, not grey alone


def test_what_has_no_twin_is_told(
    database: str, client: TestClient, make_session: Callable[..., str], post_epochs: Callable[..., Any]
) -> None:
    """No epoch: 409; too many epochs: 413; too fine a grid, or nothing to go by: 422 that says what to do."""
    empty = make_session()
    for leaf in ("twin", "coverage", "coverage.png"):
        assert client.get(f"{empty}/{leaf}").status_code == 409
    walked = make_session()
    post_epochs(walked, 0, 40)
    fine = client.get(f"{walked}/coverage", params={"step_m": 0.05})
    assert fine.status_code == 422
    assert "expected at most 20000 points" in fine.json()["detail"]
    assert client.get(f"{walked}/coverage", params={"step_m": 0.0}).status_code == 422
    silent = make_session()
    epochs = [{"epoch": n, "time_s": float(n), "anchors": {}} for n in range(3)]
    assert client.post(f"{silent}/epochs", json={"epochs": epochs}).status_code == 200
    refused = client.get(f"{silent}/twin")
    assert refused.status_code == 422, refused.text
    app = create_app(load_settings(database_url=database, workers=0, max_smoothed_epochs=2))
    with TestClient(app, base_url="http://localhost", client=("127.0.0.1", 5000)) as strict:
        assert strict.get(f"{walked}/twin").status_code == 413
