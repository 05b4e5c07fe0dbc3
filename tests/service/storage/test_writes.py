"""Writers that wait together are committed together, and each has its own outcome."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import sqlalchemy as sa
from sqlalchemy import Connection, Engine
from sqlalchemy.exc import OperationalError

from service.settings import load_settings
from service.storage.database import opened
from service.storage.store import RevisionError, Store
from service.storage.tables import measurements, sessions
from service.storage.writes import GroupWriter, Write

COUNT = 12


@pytest.fixture
def engine(database: str) -> Iterator[Engine]:
    """A database with some sessions."""
    with opened(load_settings(database_url=database).url, 5.0) as engine:
        for n in range(COUNT):
            Store(engine).create(_name(n), None, "", "{}", 100)
        yield engine


def _name(n: int) -> str:
    return f"{n:032x}"


class _Gate:
    """Transactions of an engine, the first of which waits until it is told to go on."""

    def __init__(self, engine: Engine) -> None:
        self.engine, self.go, self.begun = engine, threading.Event(), 0

    @contextmanager
    def begin(self) -> Iterator[Connection]:
        self.begun += 1
        if self.begun == 1:
            assert self.go.wait(30.0)
        with self.engine.connect().execution_options(write=True) as connection, connection.begin():
            yield connection


def _commit_all(gate: _Gate, writes: list[Write]) -> list[Exception | None]:
    """Commit writes from a thread each, all but the first while the first is being committed."""
    writer = GroupWriter(gate.begin)
    outcome: list[Exception | None] = [None] * len(writes)

    def commit(n: int) -> None:
        try:
            writer.commit(writes[n])
        except Exception as error:
            outcome[n] = error

    threads = [threading.Thread(target=commit, args=(n,)) for n in range(len(writes))]
    threads[0].start()
    while gate.begun == 0:
        threading.Event().wait(0.001)
    for thread in threads[1:]:
        thread.start()
    while len(writer._waiting) < len(writes) - 1:
        threading.Event().wait(0.001)
    gate.go.set()
    for thread in threads:
        thread.join(30.0)
    return outcome


def _logged(engine: Engine) -> dict[str, list[str]]:
    with engine.connect() as connection:
        found: dict[str, list[str]] = {}
        for row in connection.execute(sa.select(measurements.c.session_id, measurements.c.body)):
            found.setdefault(row.session_id, []).append(row.body)
        return found


def test_all_who_wait_share_one_commit(engine: Engine) -> None:
    """Twelve writers, the first alone and eleven behind it: two transactions, everything there."""
    gate = _Gate(engine)
    outcome = _commit_all(gate, [Write(_name(n), 0, "sweep", [(0, f"s{n}")]) for n in range(COUNT)])
    assert outcome == [None] * COUNT
    assert gate.begun == 2
    assert _logged(engine) == {_name(n): [f"s{n}"] for n in range(COUNT)}
    with engine.connect() as connection:
        assert set(connection.execute(sa.select(sessions.c.next_sweep)).scalars()) == {1}


def test_who_comes_too_late_is_told_alone(engine: Engine) -> None:
    """A write to a session that has moved on writes nothing; the others of its group are not disturbed."""
    gate = _Gate(engine)
    writes = [Write(_name(n), 0, "sweep", [(0, "x")]) for n in (0, 1, 2, 3)]
    writes.append(Write(_name(1), 0, "sweep", [(0, "y")]))
    outcome = _commit_all(gate, writes)
    late = [n for n, error in enumerate(outcome) if isinstance(error, RevisionError)]
    assert late in ([1], [4])
    assert sum(error is not None for error in outcome) == 1
    assert len(_logged(engine)[_name(1)]) == 1


def test_one_that_cannot_be_written_does_not_take_others_along(engine: Engine) -> None:
    """An entry that stands in the log already fails by itself; the rest of its group is committed."""
    with engine.connect().execution_options(write=True) as connection, connection.begin():
        row = {"session_id": _name(2), "kind": "sweep", "number": 0, "body": "old"}
        connection.execute(sa.insert(measurements), row)
    outcome = _commit_all(_Gate(engine), [Write(_name(n), 0, "sweep", [(0, "new")]) for n in range(4)])
    assert [error is None for error in outcome] == [True, True, False, True]
    assert _logged(engine) == {_name(n): ["old" if n == 2 else "new"] for n in range(4)}


def test_what_holds_for_all_is_told_to_all_at_once(engine: Engine) -> None:
    """A database that cannot be written is tried once for a group, not once for each of it."""
    gate = _Gate(engine)
    real = gate.begin

    @contextmanager
    def broken() -> Iterator[Connection]:
        with real() as connection:
            connection.exec_driver_sql("PRAGMA query_only=1")
            try:
                yield connection
            finally:
                connection.exec_driver_sql("PRAGMA query_only=0")

    gate.begin = broken  # type: ignore[method-assign]
    outcome = _commit_all(gate, [Write(_name(n), 0, "sweep", [(0, "x")]) for n in range(5)])
    assert all(isinstance(error, OperationalError) for error in outcome)
    assert gate.begun == 2
    assert _logged(engine) == {}
