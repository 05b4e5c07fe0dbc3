"""States as values: bytes that come back bit for bit, copies that share nothing, damage that is refused."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import FileFormatError
from estimator.slam import GaussianConfig, GaussianEngine, Prior, load_state, save_state, start
from estimator.slam.archive import pack
from estimator.slam.gaussian.state import FORMAT, GaussianState
from estimator.slam.run import config_for


@pytest.fixture(scope="module")
def state(room) -> GaussianState:
    """After thirty epochs of a run with a wall that was born."""
    measured = room.measure(51, epochs=30)
    engine = GaussianEngine(config_for(measured))
    state = engine.start(Prior.of(measured), None)
    for epoch in measured.epochs:
        state = engine.step(state, epoch, None)
    return state


def test_bytes_come_back_bit_for_bit(state):
    """Every array with its type, every number."""
    back = load_state(save_state(state))
    assert save_state(back) == save_state(state)
    for one, other in ((back.hypotheses, state.hypotheses), (back.buffer[1:], state.buffer[1:])):
        for a, b in zip(one, other, strict=True):
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
            assert a.dtype == b.dtype
    assert back.layout == state.layout
    assert (back.epoch, back.time_s, back.log_evidence) == (state.epoch, state.time_s, state.log_evidence)
    assert not back.blind


def test_slots_are_copied_whole(state):
    """A copy that shared an array would change the state before."""
    copied = state.slots.copy()
    copied.confirmed[:] = False
    copied.extent_m[:] = 0.0
    assert state.slots.confirmed.any()
    assert state.slots.extent_m.any()


def test_damage_and_other_kinds_are_told(room):
    """Truncated, foreign, another kind, or a column missing: one line that says what was expected."""
    measured = room.measure(55, epochs=1)
    data = save_state(start(measured.walls, measured.anchors, 28e9, GaussianConfig()))
    for damaged in (
        b"",
        data[: len(data) // 2],
        b"PK not a state",
        data[:-10],
        pack("other/1", {}),
        pack(FORMAT, {}),
    ):
        with pytest.raises(FileFormatError, match="expected hapslam-gaussian-state/12"):
            load_state(damaged)
