"""Sessions, measurements in, state out, as a client sees them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from fastapi.testclient import TestClient

from estimator.measurement_files import load_measurements, save_measurements
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult, load_result
from estimator.slam import run_slam


def test_a_session_is_made_listed_read_and_deleted(
    client: TestClient, walk: MeasurementSet, make_session: Any
) -> None:
    """Pages go from the newest to the oldest without repeats; a deleted session is gone."""
    urls = [make_session(name=f"walk {i}") for i in range(5)]
    seen, before = [], None
    while True:
        page = client.get(
            "/v1/sessions", params={"limit": 2, **({"before": before} if before else {})}
        ).json()
        seen += [entry["name"] for entry in page["sessions"]]
        before = page["next"]
        if before is None:
            break
    assert seen == [f"walk {i}" for i in reversed(range(5))]
    read = client.get(urls[0]).json()
    assert read["anchors"] == list(walk.anchors)
    assert (read["next_sweep"], read["next_epoch"]) == (1, 0)
    assert client.delete(urls[0]).status_code == 204
    assert client.get(urls[0]).status_code == 404
    assert client.delete(urls[0]).status_code == 404


@pytest.mark.parametrize("batch", [1, 7, 40])
def test_the_state_is_that_of_the_batch_command_bit_for_bit(
    client: TestClient,
    walk: MeasurementSet,
    reference: SlamResult,
    session_url: str,
    post_epochs: Any,
    tmp_path: Path,
    batch: int,
) -> None:
    """However the epochs are cut into requests, all estimates equal those of run_slam."""
    for first in range(0, 40, batch):
        answer = post_epochs(session_url, first, first + batch)
        assert answer.status_code == 200, answer.text
    file = tmp_path / "result.nc"
    file.write_bytes(client.get(f"{session_url}/export").content)
    result = load_result(file)
    arrays = [entry.name for entry in fields(result) if isinstance(getattr(result, entry.name), np.ndarray)]
    assert len(arrays) >= 20
    for name in arrays:
        wanted = getattr(reference, name)
        assert np.array_equal(getattr(result, name), wanted, equal_nan=wanted.dtype.kind == "f"), name


def test_every_epoch_tells_what_may_be(
    client: TestClient, session_url: str, post_epochs: Any, tmp_path: Path
) -> None:
    """At the latest and any earlier epoch: existence and the likeliest hypotheses, as in the export."""
    post_epochs(session_url, 0, 12)
    file = tmp_path / "result.nc"
    file.write_bytes(client.get(f"{session_url}/export").content)
    result = load_result(file)
    assert client.get(f"{session_url}/state").json() == client.get(f"{session_url}/state?epoch=11").json()
    several = 0
    for t in range(12):
        state = client.get(f"{session_url}/state", params={"epoch": t}).json()
        assert state["epoch"] == t
        assert [anchor["existence"] for anchor in state["anchors"]] == result.anchor_existence[t].tolist()
        columns = np.searchsorted(result.wall_id, [wall["id"] for wall in state["walls"]])
        assert [wall["existence"] for wall in state["walls"]] == result.wall_existence[t, columns].tolist()
        assert np.array_equal(np.flatnonzero(result.wall_valid[t]), np.sort(columns))
        told = state["candidates"]
        several += len(told) > 1
        assert len(told) == np.isfinite(result.candidate_weight[t]).sum() >= 1
        for c, one in enumerate(told):
            assert one["weight"] == result.candidate_weight[t, c]
            assert one["position_m"] == result.candidate_agent_m[t, c].tolist()
            has = np.flatnonzero(np.isfinite(result.candidate_wall_mean_m[t, c, :, 0]))
            assert {wall["id"] for wall in one["walls"]} == set(result.candidate_wall_id[has].tolist())
    assert several > 0


def test_the_log_comes_back_as_the_measurement_file_it_was(
    client: TestClient,
    walk: MeasurementSet,
    reference: SlamResult,
    session_url: str,
    post_epochs: Any,
    tmp_path: Path,
) -> None:
    """A measurement file made from the log gives the same run in the batch command."""
    post_epochs(session_url, 0, 40)
    file = tmp_path / "log.nc"
    file.write_bytes(client.get(f"{session_url}/measurements").content)
    again = run_slam(load_measurements(file), seed=reference.seed)
    assert np.array_equal(again.agent_mean, reference.agent_mean)


def test_the_same_epochs_again_change_nothing(client: TestClient, session_url: str, post_epochs: Any) -> None:
    """A repeated request is answered byte for byte as before; part known, part new works too."""
    first = post_epochs(session_url, 0, 10)
    again = post_epochs(session_url, 0, 10)
    assert (first.headers["X-New-Entries"], again.headers["X-New-Entries"]) == ("10", "0")
    assert again.content == first.content
    overlap = post_epochs(session_url, 5, 12)
    assert overlap.headers["X-New-Entries"] == "2"
    assert client.get(session_url).json()["next_epoch"] == 12


def test_conflicts_say_what_is_expected(
    client: TestClient, session_url: str, post_epochs: Any, epochs_request: Any
) -> None:
    """A gap, another body under a known number, a step back in time: 409, and nothing is taken in."""
    post_epochs(session_url, 0, 3)
    before = client.get(f"{session_url}/state").content
    gap = post_epochs(session_url, 5, 6)
    changed = epochs_request(1, 5)
    changed["epochs"][0]["anchors"]["pa1"]["delay_s"][0] *= 1.0 + 1e-15
    other = client.post(f"{session_url}/epochs", json=changed)
    back = epochs_request(3, 4)
    back["epochs"][0]["time_s"] = 0.5
    early = client.post(f"{session_url}/epochs", json=back)
    hole = epochs_request(3, 6)
    del hole["epochs"][1]
    holed = client.post(f"{session_url}/epochs", json=hole)
    for answer, expected in ((gap, 3), (other, 3), (early, 3), (holed, 4)):
        problem = answer.json()
        assert answer.status_code == 409, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        assert problem["expected"]["next_epoch"] == expected, problem
        assert "expected" in problem["detail"]
    assert client.get(f"{session_url}/state").content == before


def test_sweeps_come_before_the_epochs(
    client: TestClient, session_url: str, post_epochs: Any, sweep_request: Any
) -> None:
    """A second sweep adds walls, the same again is a no-op, and after epoch 0 none is taken in."""
    sweep = sweep_request()
    assert client.post(f"{session_url}/sweeps", json=sweep).headers["X-New-Entries"] == "0"
    flash = {"range_m": 15.0, "range_std_m": 0.1, "azimuth_rad": 1.57, "azimuth_std_rad": 0.01}
    second = {"sweep": 1, "flashes": [flash]}
    assert client.post(f"{session_url}/sweeps", json=second).status_code == 200
    assert client.post(f"{session_url}/sweeps", json={"sweep": 1}).status_code == 409
    assert client.post(f"{session_url}/sweeps", json={"sweep": 3}).status_code == 409
    post_epochs(session_url, 0, 1)
    assert len(client.get(f"{session_url}/state").json()["walls"]) == 4
    late = client.post(f"{session_url}/sweeps", json={"sweep": 2})
    assert late.status_code == 409
    assert "before epoch 0" in late.json()["detail"]


def test_a_flash_is_a_wall_half_way_to_its_mirror_image(client: TestClient, make_session: Any) -> None:
    """Range r in direction phi gives the VRP 2 r (cos, sin) with the spread turned accordingly."""
    url = make_session(sweep=False)
    flash = {"range_m": 10.0, "range_std_m": 0.05, "azimuth_rad": np.pi / 2, "azimuth_std_rad": 0.01}
    client.post(f"{url}/sweeps", json={"flashes": [flash]})
    epoch = {"epoch": 0, "time_s": 0.0, "anchors": {}}
    state = client.post(f"{url}/epochs", json={"epochs": [epoch]}).json()["state"]
    assert state["walls"][0]["vrp_m"] == pytest.approx([0.0, 20.0], abs=1e-9)
    assert np.diag(state["walls"][0]["covariance_m2"]) == pytest.approx([0.2**2, 0.1**2], rel=1e-6)


def test_state_at_every_earlier_epoch(
    client: TestClient, reference: SlamResult, session_url: str, post_epochs: Any
) -> None:
    """The estimates of an epoch do not change when later epochs come."""
    post_epochs(session_url, 0, 40)
    for epoch in (0, 17, 39):
        state = client.get(f"{session_url}/state", params={"epoch": epoch}).json()
        assert state["epoch"] == epoch
        assert state["agent"]["position_m"] == reference.agent_mean[epoch, :2].tolist()
    assert client.get(f"{session_url}/state", params={"epoch": 40}).status_code == 409
    track = client.get(f"{session_url}/trajectory", params={"first": 10, "limit": 5}).json()
    assert track["epoch"] == [10, 11, 12, 13, 14]
    assert track["x_m"] == reference.agent_mean[10:15, 0].tolist()
    assert track["variance_y_m2"] == reference.agent_covariance[10:15, 1, 1].tolist()


def test_maps_as_json_geojson_and_pictures(client: TestClient, make_session: Any, post_epochs: Any) -> None:
    """The map is in the start frame's coordinates; GeoJSON holds the same; pictures are pictures."""
    turned = make_session(start_frame={"position_m": [6.0, 5.0], "heading_rad": 0.0})
    post_epochs(turned, 0, 20)
    plan = client.get(f"{turned}/map").json()
    assert plan["frame"] == "plan"
    assert plan["track_m"][0] == pytest.approx([6.0, 5.0], abs=0.5)
    geojson = client.get(f"{turned}/map", params={"format": "geojson"}).json()
    kinds = [feature["properties"]["kind"] for feature in geojson["features"]]
    assert kinds.count("wall") == len(plan["walls"]) >= 3
    assert kinds[-2:] == ["agent", "track"]
    assert client.get(f"{turned}/map.png").content.startswith(b"\x89PNG")
    assert b"<svg" in client.get(f"{turned}/map.svg").content


def test_exports_carry_units(client: TestClient, session_url: str, post_epochs: Any, tmp_path: Path) -> None:
    """Every variable of the exported file has a unit."""
    post_epochs(session_url, 0, 5)
    file = tmp_path / "result.nc"
    file.write_bytes(client.get(f"{session_url}/export").content)
    with xr.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
        assert all("units" in data[name].attrs for name in data.data_vars)


def test_unknown_engines_and_anchors_are_refused(
    client: TestClient, walk: MeasurementSet, session_url: str, make_request: Any
) -> None:
    """What the estimator does not know is answered 422 with what it knows."""
    for wrong in ({"method": "psychic"}, {"engine": "steam"}, {"measurement_model": {"colour": 1}}):
        answer = client.post("/v1/sessions", json=make_request(**wrong))
        assert answer.status_code == 422, answer.text
        assert "expected" in answer.json()["detail"]
    paths = {"delay_s": [1e-7], "delay_std_s": [1e-10]}
    epoch = {"epoch": 0, "time_s": 0.0, "anchors": {"nobody": paths}}
    answer = client.post(f"{session_url}/epochs", json={"epochs": [epoch]})
    assert answer.status_code == 422
    assert "'nobody'" in answer.json()["detail"]
    pairs = client.get("/v1/methods").json()
    assert {"method": "hybrid", "engine": "gaussian"} in pairs


def test_events_are_all_told_in_order(client: TestClient, session_url: str, post_epochs: Any) -> None:
    """A client that comes back with Last-Event-ID gets exactly what followed."""
    post_epochs(session_url, 0, 8)
    told = _events(client, session_url, {})
    assert [number for number, _ in told] == list(range(8))
    assert told[3][1] == client.get(f"{session_url}/state", params={"epoch": 3}).json()
    post_epochs(session_url, 8, 12)
    rest = _events(client, session_url, {"Last-Event-ID": "5"})
    assert [number for number, _ in rest] == list(range(6, 12))


def _events(client: TestClient, url: str, headers: dict[str, str]) -> list[tuple[int, Any]]:
    text = client.get(f"{url}/events", params={"follow": False}, headers=headers).text
    blocks = [
        dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
        for block in text.strip().split("\n\n")
    ]
    return [
        (int(block["id"]), json.loads(block["data"])) for block in blocks if block.get("event") == "epoch"
    ]


def test_the_truth_is_kept_beside_the_session(client: TestClient, session_url: str) -> None:
    """What is put is got; a session without truth says null."""
    assert client.get(f"{session_url}/truth").json() is None
    truth = {"walls": [{"name": "w", "from_m": [0, 0], "to_m": [1, 0]}], "track_m": [[0, 0], [1, 1]]}
    assert client.put(f"{session_url}/truth", json=truth).status_code == 204
    assert client.get(f"{session_url}/truth").json()["track_m"] == [[0.0, 0.0], [1.0, 1.0]]


def test_health_and_metrics(client: TestClient, session_url: str, post_epochs: Any) -> None:
    """Probes answer, and what was taken in is counted."""
    post_epochs(session_url, 0, 4)
    assert client.get("/livez").json() == {"status": "alive"}
    assert client.get("/readyz").status_code == 200
    assert "hapslam_epochs_total 4.0" in client.get("/metrics").text


def test_a_session_is_made_once_however_often_it_is_asked_for(
    client: TestClient, make_request: Callable[..., Any], walk: MeasurementSet, tmp_path: Path
) -> None:
    """With an Idempotency-Key the same request names the same session; another one is a conflict."""
    once = {"Idempotency-Key": "a-1"}
    first = client.post("/v1/sessions", json=make_request(), headers=once)
    again = client.post("/v1/sessions", json=make_request(), headers=once)
    assert (first.status_code, again.status_code) == (201, 201)
    assert first.headers["Location"] == again.headers["Location"]
    other = client.post("/v1/sessions", json=make_request(name="another"), headers=once)
    assert other.status_code == 409
    save_measurements(walk, tmp_path / "walk.nc")
    upload = {"Idempotency-Key": "u-1", "Content-Type": "application/octet-stream"}
    body = (tmp_path / "walk.nc").read_bytes()
    places = {client.post("/v1/uploads", content=body, headers=upload).headers["Location"] for _ in range(2)}
    assert len(places) == 1
    assert len(client.get("/v1/sessions").json()["sessions"]) == 2
    assert client.post("/v1/sessions", json=make_request()).status_code == 201
    assert len(client.get("/v1/sessions").json()["sessions"]) == 3


def test_a_list_tells_which_sessions_may_be_relied_on(
    client: TestClient, make_session: Callable[..., str], post_epochs: Callable[..., Any]
) -> None:
    """Each session says what its last epoch is worth; a new one says nothing."""
    walked, new = make_session(), make_session()
    post_epochs(walked, 0, 40)
    listed = {session["id"]: session for session in client.get("/v1/sessions").json()["sessions"]}
    state = client.get(f"{walked}/state").json()["integrity"]["state"]
    assert listed[walked.rpartition("/")[2]]["integrity"] == state != "unknown"
    assert listed[new.rpartition("/")[2]]["integrity"] is None
    assert client.get(walked).json()["integrity"] == state
