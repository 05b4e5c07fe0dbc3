"""Anchors added to a session that has epochs: computed anew, as if they had been there unheard."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response

from service.session.verify import verify
from service.storage.store import RevisionError, Store

_ANCHORS = ["pa1", "pa2", "attic"]


def _verified(client: TestClient) -> list[tuple[str, ...]]:
    app: Any = client.app
    return [finding.differences for finding in verify(app.state.context.store)]


def test_a_session_goes_on_with_one_more_anchor(
    client: TestClient,
    session_url: str,
    post_epochs: Callable[..., Response],
    epochs_request: Callable[[int, int], Any],
) -> None:
    """Earlier epochs stay known and say what they said; the new anchor is heard from then on."""
    post_epochs(session_url, 0, 12)
    before = client.get(f"{session_url}/trajectory").json()
    changed = client.patch(session_url, json={"anchors": _ANCHORS})
    assert changed.status_code == 200, changed.text
    assert (changed.json()["anchors"], changed.json()["next_epoch"]) == (_ANCHORS, 12)
    after = client.get(f"{session_url}/trajectory").json()
    assert np.allclose(after["x_m"], before["x_m"], atol=1e-6)
    names = [anchor["name"] for anchor in client.get(f"{session_url}/state?epoch=3").json()["anchors"]]
    assert names == _ANCHORS
    assert post_epochs(session_url, 10, 13).headers["X-New-Entries"] == "1"
    heard = epochs_request(13, 14)
    heard["epochs"][0]["anchors"]["attic"] = {"delay_s": [4e-8], "delay_std_s": [3e-10]}
    assert client.post(f"{session_url}/epochs", json=heard).status_code == 200
    assert json.loads(client.get(session_url).content)["next_epoch"] == 14
    assert _verified(client) == [()]


def test_the_list_tells_the_integrity_of_the_run_computed_anew(
    database: str, client: TestClient, session_url: str, post_epochs: Callable[..., Response]
) -> None:
    """What the session's row says of its last epoch is what its estimate says, whatever stood there."""
    post_epochs(session_url, 0, 12)
    with sqlite3.connect(database.removeprefix("sqlite:///")) as direct:
        direct.execute("UPDATE sessions SET integrity = 'lost'")
    assert client.get(session_url).json()["integrity"] == "lost"
    assert client.patch(session_url, json={"anchors": _ANCHORS}).status_code == 200
    state = client.get(f"{session_url}/state").json()["integrity"]["state"]
    assert client.get(session_url).json()["integrity"] == state != "lost"


def test_what_cannot_be_added_changes_nothing(
    client: TestClient, session_url: str, post_epochs: Callable[..., Response]
) -> None:
    """Anchors of before that are missing, names twice: refused, and the session is as it was."""
    post_epochs(session_url, 0, 3)
    before = client.get(session_url).content
    for anchors in (["pa2", "pa1", "attic"], ["pa1"], ["pa1", "pa2", "pa1"]):
        assert client.patch(session_url, json={"anchors": anchors}).status_code == 422
    assert client.get(session_url).content == before


def test_an_epoch_that_comes_meanwhile_is_not_lost(
    client: TestClient,
    session_url: str,
    post_epochs: Callable[..., Response],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the session has moved on when the run is computed, it is computed again, with what came."""
    from service.storage.store import Step

    post_epochs(session_url, 0, 4)
    tries: list[int] = []
    rewrite = Step.rewrite

    def late(self: Step, new: Any) -> None:
        tries.append(len(new.epochs))
        if len(tries) == 1:
            raise RevisionError
        rewrite(self, new)

    monkeypatch.setattr(Step, "rewrite", late)
    assert client.patch(session_url, json={"anchors": _ANCHORS}).status_code == 200
    assert tries == [4, 4]
    assert isinstance(client.app.state.context.store, Store)  # type: ignore[attr-defined]
    assert _verified(client) == [()]
