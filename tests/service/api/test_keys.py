"""Who may use the service: keys, their sessions, and callers without a key."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx2
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from estimator.errors import ConfigurationError
from estimator.measurements import MeasurementSet
from service.api.app import create_app
from service.api.auth import KeyRing, is_loopback
from service.api.serve import check_binding
from service.client import Client
from service.errors import DatabaseError, NotFoundError
from service.messages.requests import session_entry
from service.settings import load_settings
from service.storage.database import opened
from service.storage.tables import api_keys, shares
from tests.service.harness import Server


@pytest.fixture
def keys(database: str) -> Iterator[KeyRing]:
    """The keys in the test's database."""
    with opened(load_settings(database_url=database).url, 5.0) as engine:
        yield KeyRing(engine)


def _as(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def test_a_key_opens_its_own_sessions_alone(
    keys: KeyRing,
    client: TestClient,
    make_request: Callable[..., Any],
    sweep_request: Callable[..., Any],
    epochs_request: Callable[..., Any],
) -> None:
    """In every route a session of another key is as unknown as one that never was."""
    ann, bob = keys.create("ann"), keys.create("bob")
    url = client.post("/v1/sessions", json=make_request(), headers=_as(ann)).headers["Location"]
    assert client.post(f"{url}/sweeps", json=sweep_request(), headers=_as(ann)).status_code == 200
    posted = client.post(f"{url}/epochs", json=epochs_request(0, 1), headers=_as(ann))
    assert posted.status_code == 200
    asked = 0
    for request in _requests_of_sessions(client.get("/openapi.json").json(), url[-32:]):
        never = {**request, "url": request["url"].replace(url[-32:], "0" * 32)}
        answers = [
            client.request(**{**one, "headers": _as(bob) | one.get("headers", {})})
            for one in (request, never)
        ]
        assert [answer.status_code for answer in answers] == [404, 404], request
        details = [answer.json()["detail"].replace(url[-32:], "0" * 32) for answer in answers]
        assert details[0] == details[1]
        asked += 1
    assert asked >= 18
    assert client.get(f"{url}/state", headers=_as(ann)).status_code == 200
    assert client.get("/v1/sessions", headers=_as(bob)).json()["sessions"] == []
    assert client.get(url, headers=_as(ann)).status_code == 200


_PARAMETERS = {"noise_variance": "1", "protocol": "nrppa", "epoch": "0"}  # those without a default


def _requests_of_sessions(document: dict[str, Any], session: str) -> Iterator[dict[str, Any]]:
    """A valid request of each type of body for each operation on a session that the interface names."""
    schemas = document["components"]["schemas"]
    for path, operations in document["paths"].items():
        if "{session_id}" not in path:
            continue
        for method, operation in operations.items():
            contents = operation.get("requestBody", {}).get("content", {"": {}})
            named = {entry["name"] for entry in operation.get("parameters", ())}
            wanted = {name: value for name, value in _PARAMETERS.items() if name in named}
            for kind, content in contents.items():
                request: dict[str, Any] = {"method": method, "url": path.replace("{session_id}", session)}
                if kind == "application/json":
                    schema = schemas[content["schema"]["$ref"].rsplit("/", 1)[1]]
                    request["json"] = schema.get("examples", [{}])[0]
                elif kind:
                    request |= {"content": b"rubbish", "headers": {"Content-Type": kind}}
                    request["params"] = wanted
                yield request


def test_without_a_valid_key_there_is_no_entry(keys: KeyRing, client: TestClient) -> None:
    """No key, a wrong scheme, a wrong secret, a revoked key, rubbish: 401 each."""
    key = keys.create("ann")
    assert client.get("/v1/sessions", headers=_as(key)).status_code == 200
    wrong = key[:-1] + ("A" if key[-1] != "A" else "B")
    for headers in ({}, {"Authorization": f"Basic {key}"}, _as(wrong), _as("x" * 5000), _as("hapslam_")):
        answer = client.get("/v1/sessions", headers=headers)
        assert answer.status_code == 401
        assert answer.headers["WWW-Authenticate"] == "Bearer"
    keys.revoke(keys.list()[0].id)
    assert client.get("/v1/sessions", headers=_as(key)).status_code == 401


def test_keys_are_kept_as_digests(keys: KeyRing) -> None:
    """Neither the key nor its secret stands in the database; a key can be revoked once."""
    key = keys.create("ann")
    secret = key.rsplit("_", 1)[0], key[21:]
    with keys._engine.connect() as connection:
        row = connection.execute(sa.select(api_keys)).one()
    assert all(part.encode() not in bytes(row.secret_sha256) for part in secret)
    assert len(row.secret_sha256) == 32
    keys.revoke(row.id)
    with pytest.raises(NotFoundError, match="in force"):
        keys.revoke(row.id)


def test_secrets_are_compared_in_constant_time(
    keys: KeyRing, client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The comparison goes through hmac.compare_digest, also for keys that do not exist."""
    compared = []
    monkeypatch.setattr(
        "service.api.auth.hmac.compare_digest", lambda a, b: compared.append((len(a), len(b))) or a == b
    )
    key = keys.create("ann")
    client.get("/v1/sessions", headers=_as(key))
    client.get("/v1/sessions", headers=_as("hapslam_000000000000_" + "a" * 43))
    assert compared == [(32, 32), (32, 32)]


def test_without_keys_only_this_machine_is_served(database: str) -> None:
    """From elsewhere, or under another machine's name, 403; on this machine all is well."""
    app = create_app(load_settings(database_url=database, workers=0))
    for client_address, base, status in (
        ("127.0.0.1", "http://localhost", 200),
        ("::1", "http://[::1]:8600", 200),
        ("192.0.2.7", "http://localhost", 403),
        ("127.0.0.1", "http://evil.example", 403),
    ):
        with TestClient(app, base_url=base, client=(client_address, 5000)) as client:
            assert client.get("/v1/sessions").status_code == status, (client_address, base)


def test_listening_elsewhere_needs_a_key(keys: KeyRing, database: str) -> None:
    """Binding beyond loopback is refused until a key exists."""
    settings = load_settings(database_url=database, host="0.0.0.0")
    with pytest.raises(ConfigurationError, match="hapslam key create"):
        check_binding(settings)
    check_binding(load_settings(database_url=database, host="::1"))
    keys.create("ann")
    check_binding(settings)


def test_what_is_loopback() -> None:
    """Names and addresses of this machine, and those that only look so."""
    assert all(map(is_loopback, ("127.0.0.1", "127.8.9.1", "::1", "[::1]", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "localhost.example", "", None)))


def test_a_database_that_cannot_be_opened_is_told() -> None:
    """A folder that does not exist gives one clear line, without the password of a URL."""
    settings = load_settings(database_url="sqlite:////nowhere/at/all.db")
    with pytest.raises(DatabaseError, match="expected one that can be opened"):
        check_binding(settings)
    hidden = load_settings(database_url="postgresql://me:secret@127.0.0.1:1/none")
    with pytest.raises(DatabaseError) as caught:
        check_binding(hidden)
    assert "secret" not in str(caught.value)


def test_a_key_that_reads_changes_nothing(
    keys: KeyRing, client: TestClient, make_request: Callable[..., Any]
) -> None:
    """It sees what its owner has, and every request that would change something is refused."""
    ann = keys.create("ann")
    reader = keys.create("reader", "read", keys.list()[0].id)
    url = client.post("/v1/sessions", json=make_request(), headers=_as(ann)).headers["Location"]
    assert client.get(url, headers=_as(reader)).status_code == 200
    assert len(client.get("/v1/sessions", headers=_as(reader)).json()["sessions"]) == 1
    for method, path in (
        ("POST", "/v1/sessions"),
        ("DELETE", url),
        ("PUT", f"{url}/truth"),
        ("POST", f"{url}/shares"),
    ):
        answer = client.request(method, path, headers=_as(reader))
        assert (answer.status_code, answer.json()["type"]) == (403, "urn:hapslam:problem:forbidden")
    assert client.get(url, headers=_as(ann)).status_code == 200
    with pytest.raises(NotFoundError, match="in force"):
        keys.create("nobody's", "read", "0" * 12)


def test_a_share_opens_one_session_until_it_expires(
    keys: KeyRing, client: TestClient, make_request: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its key reads that session and nothing else; after its hours it is let in no more."""
    ann = keys.create("ann")
    one, two = (
        client.post("/v1/sessions", json=make_request(), headers=_as(ann)).headers["Location"] for _ in "ab"
    )
    made = client.post(f"{one}/shares", params={"hours": 1}, headers=_as(ann))
    assert made.status_code == 201
    share = made.json()["key"]
    assert made.json()["link"] == f"/#/s/{one[-32:]}/{share}"
    assert client.get(one, headers=_as(share)).status_code == 200
    assert client.get(two, headers=_as(share)).status_code == 404
    assert [s["id"] for s in client.get("/v1/sessions", headers=_as(share)).json()["sessions"]] == [one[-32:]]
    for method, path in (("DELETE", one), ("POST", f"{one}/shares"), ("POST", "/v1/sessions")):
        assert client.request(method, path, headers=_as(share)).status_code == 403
    with keys._engine.connect().execution_options(write=True) as connection, connection.begin():
        connection.execute(sa.update(shares).values(expires_at=datetime.now(UTC) - timedelta(seconds=1)))
    assert client.get(one, headers=_as(share)).status_code == 401


def test_a_key_is_rotated_and_its_sessions_are_given_away(
    keys: KeyRing, client: TestClient, make_request: Callable[..., Any]
) -> None:
    """A new secret for the same sessions; of a revoked key, its sessions for another key."""
    ann = keys.create("ann")
    ann_id = keys.list()[0].id
    url = client.post("/v1/sessions", json=make_request(), headers=_as(ann)).headers["Location"]
    again = keys.rotate(ann_id)
    assert client.get(url, headers=_as(ann)).status_code == 401
    assert client.get(url, headers=_as(again)).status_code == 200
    keys.revoke(ann_id)
    bob = keys.create("bob")
    assert client.get(url, headers=_as(bob)).status_code == 404
    assert keys.transfer(ann_id, bob.split("_")[1]) == 1
    assert client.get(url, headers=_as(bob)).status_code == 200
    with pytest.raises(NotFoundError, match="in force"):
        keys.rotate(ann_id)
    with pytest.raises(NotFoundError, match="expected the id of a key"):
        keys.transfer("f" * 12, bob.split("_")[1])


def test_a_stream_ends_with_its_key(database: str, keys: KeyRing, walk: MeasurementSet) -> None:
    """Who follows a session with a key that is revoked is told nothing more, within a second or so."""
    key = keys.create("ann")
    with Server(database, workers=1) as server, Client(server.url, key) as client:
        session = client.create_session(session_entry(walk))
        url = f"{server.url}/v1/sessions/{session}/events"
        with httpx2.stream("GET", url, headers=_as(key), timeout=30.0) as stream:
            lines = stream.iter_lines()
            assert next(lines)
            keys.revoke(keys.list()[0].id)
            begin = time.monotonic()
            assert "event: deleted" in list(lines)
        assert time.monotonic() - begin < 10.0


def test_the_counters_want_a_key(keys: KeyRing, client: TestClient) -> None:
    """What the service counts is for those who have a key; the probes are for everyone."""
    key = keys.create("ann")
    assert client.get("/metrics", headers=_as(key)).status_code == 200
    assert client.get("/metrics").status_code == 401
    assert client.get("/livez").status_code == client.get("/readyz").status_code == 200


@pytest.mark.parametrize("name", ["a\u202eb", "a\u2066b", "a\u200bb", "a\u0085b", "a\ufeff", "a\u2028b"])
def test_names_are_what_they_seem(client: TestClient, make_request: Callable[..., Any], name: str) -> None:
    """No invisible characters, none that turn the text; what is composed of pieces becomes one letter."""
    for changed in ({"name": name}, {"anchors": [name, "b"]}):
        answer = client.post("/v1/sessions", json=make_request(**changed))
        assert answer.status_code == 422
        assert "expected letters that can be seen" in answer.json()["detail"]
    made = client.post("/v1/sessions", json=make_request(name="Bu\u0308ro"))
    assert made.json()["name"] == "B\u00fcro"
