"""What taking measurements writes, and one commit for all who want to write at the same time.

SQLite has one writer, and each commit waits for the disk. Threads that come while another
commits are therefore committed together by the next of them: one transaction and one sync
for all, and no one is told that it is done before that.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Dialect
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import OperationalError

from service.storage.folded import Folded
from service.storage.tables import estimates, measurements, sessions, snapshots

__all__ = ["GroupWriter", "RevisionError", "Write", "apply"]

_OF_SESSION = sa.and_(
    sessions.c.id == sa.bindparam("session"), sessions.c.revision == sa.bindparam("read_revision")
)
_COUNT_ON = (
    sa.update(sessions)
    .where(_OF_SESSION)
    .values(revision=sa.bindparam("new_revision"), updated_at=sa.bindparam("now"))
)
_MOVE_ON = {
    "epoch": _COUNT_ON.values(
        next_epoch=sa.bindparam("next"),
        time_s=sa.bindparam("last_time_s"),
        integrity=sa.bindparam("last_integrity"),
    ),
    "sweep": _COUNT_ON.values(next_sweep=sa.bindparam("next")),
}
_LOG, _ESTIMATES = sa.insert(measurements), sa.insert(estimates)


def _upsert(insert: Any) -> Any:
    new = insert(snapshots)
    return new.on_conflict_do_update(
        index_elements=["session_id"],
        set_={name: new.excluded[name] for name in ("epoch", "state", "sha256")},
    )


_SNAPSHOT = {"sqlite": _upsert(sqlite.insert), "postgresql": _upsert(postgresql.insert)}


class RevisionError(Exception):
    """Someone else took measurements into the session meanwhile; begin anew."""


@dataclass(eq=False)
class Write:
    """Log entries of a session and what was computed from them.

    Parameters
    ----------
    session_id : str
        The session.
    revision : int
        Its revision when it was read: if it has moved on, nothing is written.
    kind : str
        ``"epoch"`` or ``"sweep"``.
    entries : sequence of (int, str)
        Numbers and bodies, in order.
    folded : Folded, optional
        State and estimates after them.
    time_s : float, optional
        Time of the last epoch.
    error : Exception, optional
        What became of it, if not what was wanted.
    done : bool
        Whether it is known what became of it.
    """

    session_id: str
    revision: int
    kind: str
    entries: Sequence[tuple[int, str]]
    folded: Folded | None = None
    time_s: float | None = None
    error: Exception | None = field(default=None, init=False)
    done: bool = field(default=False, init=False)


def apply(connection: Connection, writes: Sequence[Write]) -> None:
    """Write in a transaction that is open; of sessions that have moved on nothing is written.

    Their ``error`` is a RevisionError afterwards.
    """
    now, fresh = datetime.now(UTC), []
    for write in writes:
        moved: dict[str, Any] = {
            "session": write.session_id,
            "read_revision": write.revision,
            "new_revision": write.revision + 1,
            "now": now,
            "next": write.entries[-1][0] + 1,
        }
        if write.kind == "epoch":
            moved["last_time_s"] = write.time_s
            moved["last_integrity"] = None if write.folded is None else write.folded.integrity
        if connection.execute(_MOVE_ON[write.kind], moved).rowcount == 1:
            fresh.append(write)
        else:
            write.error = RevisionError()
    log = [
        {"session_id": write.session_id, "kind": write.kind, "number": number, "body": body}
        for write in fresh
        for number, body in write.entries
    ]
    folded = [(write, write.folded) for write in fresh if write.folded is not None]
    rows = [{"session_id": write.session_id, **row} for write, made in folded for row in made.estimates]
    kept = [
        {
            "session_id": write.session_id,
            "epoch": write.entries[-1][0],
            "state": made.snapshot,
            "sha256": made.sha256,
        }
        for write, made in folded
    ]
    for statement, values in ((_LOG, log), (_ESTIMATES, rows), (_snapshot(connection.dialect), kept)):
        if values:
            connection.execute(statement, values)


def _snapshot(dialect: Dialect) -> Any:
    return _SNAPSHOT[dialect.name]


class GroupWriter:
    """Writers take turns; those who wait together are committed together.

    Parameters
    ----------
    begin : callable
        Gives a connection in a transaction that is committed at the end.
    """

    def __init__(self, begin: Callable[[], AbstractContextManager[Connection]]) -> None:
        self._begin = begin
        self._guard, self._turn = threading.Lock(), threading.Lock()
        self._waiting: list[Write] = []

    @contextmanager
    def alone(self) -> Iterator[Connection]:
        """A transaction of one's own, in turn."""
        with self._turn, self._begin() as connection:
            yield connection

    def commit(self, write: Write) -> None:
        """Commit a write, together with those of others; raises what became of this one."""
        with self._guard:
            self._waiting.append(write)
        with self._turn:
            if not write.done:
                with self._guard:
                    group, self._waiting = self._waiting, []
                self._commit(group)
        if write.error is not None:
            raise write.error

    def _commit(self, group: list[Write]) -> None:
        """Commit a group; if one of it cannot be written, each alone, so that the others are."""
        for write in group:
            write.error = None
        try:
            with self._begin() as connection:
                apply(connection, group)
        except OperationalError as error:  # locked, full, read-only, gone: so for all of them
            for write in group:
                write.error = error
        except Exception as error:
            if len(group) > 1:
                for write in group:
                    self._commit([write])
                return
            group[0].error = error
        for write in group:
            write.done = True
