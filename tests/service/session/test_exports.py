"""What is exported is read back, by readers of others and of the test, and is what the map says."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

_FRAME = {"position_m": [3.0, -2.0], "heading_rad": 0.6}
_EPOCHS = 20


@pytest.fixture
def url(make_session: Callable[..., str], post_epochs: Callable[..., Response]) -> str:
    """A session of twenty epochs that states its start frame."""
    url = make_session(start_frame=_FRAME)
    assert post_epochs(url, 0, _EPOCHS).status_code == 200
    return url


def test_an_mcap_file_is_read_back(client: TestClient, url: str) -> None:
    """Poses, covariances and markers decode by their own definitions and are those of the map."""
    content = client.get(f"{url}/export?format=mcap").content
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    found: dict[str, list[Any]] = {}
    for _, channel, message, decoded in reader.iter_decoded_messages():
        found.setdefault(channel.topic, []).append((message.log_time, decoded))
    document, track = client.get(f"{url}/map").json(), client.get(f"{url}/trajectory").json()
    assert reader.get_header().profile == "ros2"
    poses = found["/agent/pose"]
    assert [time for time, _ in poses] == [round(1e9 * value) for value in track["time_s"]]
    places = [(pose.pose.pose.position.x, pose.pose.pose.position.y) for _, pose in poses]
    assert np.allclose(places, document["track_m"], atol=1e-12)
    last = np.array(poses[-1][1].pose.covariance).reshape(6, 6)
    assert np.allclose(last[:2, :2], document["agent"]["covariance_m2"], atol=1e-12)
    assert not last[2:].any()
    ((_, marks),) = found["/map"]
    walls = {mark.id: mark for mark in marks.markers if mark.ns == "walls"}
    assert len(walls) == len(document["walls"]) > 0
    for wall in document["walls"]:
        points = [(point.x, point.y) for point in walls[wall["id"]].points]
        assert np.allclose(points, wall["segment_m"], atol=1e-12)
    names = [mark.text for mark in marks.markers if mark.ns == "names"]
    assert names == [anchor["name"] for anchor in document["anchors"] if anchor["located"]]


def test_a_track_is_read_back(client: TestClient, url: str) -> None:
    """Lines of eight numbers: time, place in the map's frame, and a rotation that is none."""
    text = client.get(f"{url}/export?format=tum").text
    rows = np.array([line.split() for line in text.splitlines() if not line.startswith("#")], dtype=float)
    document, track = client.get(f"{url}/map").json(), client.get(f"{url}/trajectory").json()
    assert rows.shape == (_EPOCHS, 8)
    assert rows[:, 0].tolist() == track["time_s"]
    assert rows[:, 1:3].tolist() == document["track_m"]
    assert (rows[:, 3:] == (0, 0, 0, 0, 1)).all()


def test_a_location_is_that_of_the_map(client: TestClient, url: str) -> None:
    """The ellipse is the covariance, clockwise from the y axis; the velocity is that of the agent."""
    found = client.get(f"{url}/map?format=location&epoch=12").json()
    agent = client.get(f"{url}/map?epoch=12").json()["agent"]
    estimate, speed = found["locationEstimate"], found["velocityEstimate"]
    assert estimate["shape"] == "LOCAL_2D_POINT_UNCERTAINTY_ELLIPSE"
    assert [estimate["point"]["x"], estimate["point"]["y"]] == agent["position_m"]
    ellipse = estimate["uncertaintyEllipse"]
    bearing = np.radians(ellipse["orientationMajor"])
    major = np.array([np.sin(bearing), np.cos(bearing)])
    minor = np.array([major[1], -major[0]])
    again = sum(
        length**2 * np.outer(axis, axis)
        for length, axis in ((ellipse["semiMajor"], major), (ellipse["semiMinor"], minor))
    )
    wanted = np.array(agent["covariance_m2"])
    spread = ellipse["semiMajor"] ** 2 - ellipse["semiMinor"] ** 2
    assert np.allclose(again, wanted, atol=2 * spread * np.radians(0.5) + 1e-12)  # whole degrees
    assert speed["hSpeed"] == pytest.approx(3.6 * np.hypot(*agent["velocity_m_s"]))
    assert speed["bearing"] == pytest.approx(np.degrees(np.arctan2(*agent["velocity_m_s"])) % 360, abs=0.51)


def test_features_name_their_reference_system(client: TestClient, url: str) -> None:
    """JSON-FG has the places of GeoJSON under a local reference system, and no degrees."""
    plain = client.get(f"{url}/map?format=geojson").json()["features"]
    document = client.get(f"{url}/map?format=json-fg").json()
    assert document["coordRefSys"].startswith("urn:hapslam:crs:")
    assert document["coordRefSys"].endswith(":plan")
    assert [feature["place"] for feature in document["features"]] == [each["geometry"] for each in plain]
    assert all(feature["geometry"] is None for feature in document["features"])
    assert {feature["featureType"] for feature in document["features"]} >= {"wall", "agent", "track"}


def test_what_is_not_to_be_relied_on_says_so(
    client: TestClient, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lost epoch is told by the map, GeoJSON and MCAP; the picture of an earlier epoch stays as it is."""
    plain = client.get(f"{url}/map").json()["integrity"]
    told = client.get(f"{url}/state").json()["integrity"]
    assert plain == {name: told[name] for name in ("state", "protection_level_m")}
    from service.session import results

    drawn: list[str] = []
    monkeypatch.setattr("estimator.evaluation.pictures.draw_map", lambda result, title: drawn.append(title))
    monkeypatch.setattr(
        "estimator.evaluation.pictures.save_figure", lambda figure, file: file.write_bytes(b"")
    )
    unpack = results.unpack_run

    def lost(*given: Any) -> Any:
        result = unpack(*given)
        result.integrity_state[-1] = 2
        return result

    monkeypatch.setattr(results, "unpack_run", lost)
    assert client.get(f"{url}/map").json()["integrity"]["state"] == "lost"
    features = client.get(f"{url}/map?format=geojson").json()["features"]
    (agent,) = [each["properties"] for each in features if each["properties"]["kind"] == "agent"]
    assert agent["integrity"]["state"] == "lost"
    client.get(f"{url}/map.png")
    assert drawn[0].startswith("LOST: ")
    content = client.get(f"{url}/export?format=mcap").content
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    marks = next(message[3] for message in reader.iter_decoded_messages(topics=["/map"])).markers
    assert [mark.text for mark in marks if mark.ns == "integrity"] == ["lost"]
