"""Packed estimates give the result that the estimates themselves give, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient
from httpx2 import Response

from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.slam import Engine, Estimate, Prior, epoch_rng
from estimator.slam.run import collect, config_for, engine_for
from service.messages.packed import RunTerms, pack_estimate, unpack_run

_SEED = 4
_EPOCHS = 15


def _estimates(walk: MeasurementSet, engine: Engine) -> list[Estimate]:
    state, found = engine.start(Prior.of(walk), epoch_rng(_SEED, -1)), []
    for epoch in walk.epochs:
        state = engine.step(state, epoch, epoch_rng(_SEED, epoch.index))
        found.append(engine.estimate(state))
    return found


def _same(one: SlamResult, other: SlamResult) -> None:
    for name in (field.name for field in fields(one)):
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.shape) == (b.dtype, b.shape), name
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
        else:
            assert a == b, name


@pytest.mark.parametrize("engine", ["gaussian", "particle"])
def test_a_run_is_read_at_once(walk: MeasurementSet, engine: str) -> None:
    """Of either engine: epochs with and without walls, anchors and candidates stack as estimates do."""
    few = replace(walk, epochs=walk.epochs[:_EPOCHS])
    found = _estimates(few, engine_for("hybrid", engine, config_for(few, engine=engine)))
    nothing = replace(
        found[0],
        wall_id=found[0].wall_id[:0],
        wall_mean_m=np.zeros((0, 2)),
        wall_covariance_m2=np.zeros((0, 2, 2)),
        wall_existence=np.zeros(0),
        candidates=(),
    )
    found[2] = nothing
    packed = [
        pack_estimate(epoch.index, epoch.time_s, one) for epoch, one in zip(few.epochs, found, strict=True)
    ]
    terms = RunTerms("hybrid", engine, _SEED, walk.anchors, {"a": 1})
    _same(unpack_run(packed, terms), collect(few, found, "hybrid", engine, _SEED, {"a": 1}))
    assert unpack_run([], terms).wall_mean_m.shape == (0, 0, 2)


def test_rows_of_before_are_packed_when_they_are_read(
    client: TestClient, session_url: str, post_epochs: Callable[..., Response]
) -> None:
    """A session whose first estimates were written without packing exports as one whose were not."""
    assert post_epochs(session_url, 0, 8).status_code == 200
    kinds = ("export?format=tum", "map", "map?epoch=3")
    before = [client.get(f"{session_url}/{kind}").content for kind in kinds]
    app: Any = client.app
    with app.state.context.store.writing() as connection:
        changed = connection.execute(sa.text("UPDATE estimates SET packed = NULL WHERE epoch < 5"))
        assert changed.rowcount == 5
    assert [client.get(f"{session_url}/{kind}").content for kind in kinds] == before


def test_truths_of_before_are_read(client: TestClient, session_url: str) -> None:
    """A truth is kept packed; one that was written as text reads the same."""
    given = {"track_m": [[1.25, 2.5]] * 5_000}
    assert client.put(f"{session_url}/truth", json=given).status_code == 204
    told = client.get(f"{session_url}/truth").content
    app: Any = client.app
    with app.state.context.store.writing() as connection:
        kept = connection.execute(sa.text("SELECT length(packed) FROM truths")).scalar_one()
        assert kept < len(told) / 10
        change = sa.text("UPDATE truths SET document = :text, packed = NULL")
        connection.execute(change, {"text": told.decode()})
    assert client.get(f"{session_url}/truth").content == told
