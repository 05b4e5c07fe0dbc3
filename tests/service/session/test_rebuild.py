"""Snapshots of another version of the engine: a session goes on from its log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from estimator.errors import ConfigurationError
from estimator.result import SlamResult
from estimator.slam import GaussianEngine
from service.messages.session_requests import SessionRequest
from service.session.fold import engine_of
from service.session.state_cache import StateCache


@pytest.mark.parametrize(
    "failure", [KeyError("rows"), ValueError("version 1"), AttributeError("x"), TypeError("y")]
)
def test_a_state_that_cannot_be_loaded_is_rebuilt_from_the_log(
    client: TestClient,
    session_url: str,
    post_epochs: Callable[..., Any],
    reference: SlamResult,
    monkeypatch: pytest.MonkeyPatch,
    failure: Exception,
) -> None:
    """Whatever loading an old state raises, the next epoch comes right, folded piece by piece.

    A long log is not folded where others wait: the old state is looked at twice.
    """
    assert post_epochs(session_url, 0, 12).status_code == 200
    loaded: list[bytes] = []

    def load(self: GaussianEngine, snapshot: bytes) -> Any:
        loaded.append(snapshot)
        if len(loaded) <= 2:
            raise failure
        return original(self, snapshot)

    original = GaussianEngine.load
    monkeypatch.setattr(GaussianEngine, "load", load)
    monkeypatch.setattr(StateCache, "get", lambda *_: None)  # as in a new process
    monkeypatch.setattr("service.session.sessions._REBUILT_AT_ONCE", 5)
    assert post_epochs(session_url, 12, 20).status_code == 200
    assert (
        len(loaded) == 5
    )  # the old one twice, then two pieces and the new epochs go on from what was folded
    assert loaded[0] == loaded[1] == loaded[-1]
    track = client.get(f"{session_url}/trajectory").json()
    assert np.array_equal(track["x_m"], reference.agent_mean[:20, 0])


@pytest.mark.parametrize(
    ("engine", "name", "value"),
    [
        ("gaussian", "max_hypotheses", 10**9),
        ("gaussian", "max_hypotheses", 12.5),
        ("gaussian", "most_paths", 10**6),
        ("particle", "particles", 10**9),
    ],
)
def test_counts_of_a_noise_model_are_limited(
    make_request: Callable[..., dict[str, Any]], engine: str, name: str, value: float
) -> None:
    """No session asks its engine for a billion of anything, whatever group the setting stands in."""
    config = SessionRequest.model_validate(make_request(engine=engine)).config()
    assert engine_of(config).name == engine
    config["measurement_model"] = {**config["measurement_model"], name: value}
    with pytest.raises(ConfigurationError, match=name):
        engine_of(config)
