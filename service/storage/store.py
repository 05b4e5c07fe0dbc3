"""The transactions on sessions.

SQLite and PostgreSQL through one code path. The measurement log, the snapshot and the
estimates of a request are one transaction, made only if the session's revision is still the
one that was read. On PostgreSQL the session's row is locked meanwhile, so that a second
process waits instead of computing in vain; on SQLite, where a lock would stop all sessions,
it finds the revision changed and begins anew.
"""

from __future__ import annotations

import json
import threading
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Engine, Row
from sqlalchemy.exc import IntegrityError

from service.errors import ConflictError, NotFoundError
from service.storage.folded import Folded
from service.storage.rewrites import Rewrite, rewrite
from service.storage.tables import estimates, measurements, sessions, snapshots, truths
from service.storage.writes import GroupWriter, RevisionError, Write, apply

__all__ = ["RevisionError", "Step", "Store", "unknown_session"]

_SESSION: sa.BindParameter[str] = sa.bindparam("session")
_OF_ALL = sa.select(sessions).where(sessions.c.id == _SESSION)
_OF_KEY = _OF_ALL.where(sessions.c.key_id == sa.bindparam("key"))
_OF_NO_KEY = _OF_ALL.where(sessions.c.key_id.is_(None))
_DIGEST = sa.select(snapshots.c.sha256).where(snapshots.c.session_id == _SESSION)
_SNAPSHOT = sa.select(snapshots.c.state, snapshots.c.sha256).where(snapshots.c.session_id == _SESSION)


class Step:
    """A session while measurements are taken into it: what was read, and the commit."""

    def __init__(self, connection: Connection, row: Row[Any], writer: GroupWriter | None) -> None:
        self.row = row
        self._connection = connection
        self._writer = writer

    def known(self, kind: str, first: int, last: int) -> dict[int, str]:
        """The log's entries of a kind with numbers from ``first`` to ``last``."""
        query = sa.select(measurements.c.number, measurements.c.body).where(
            measurements.c.session_id == self.row.id,
            measurements.c.kind == kind,
            measurements.c.number.between(first, last),
        )
        return {
            row.number: row.body for row in self._connection.execute(query.order_by(measurements.c.number))
        }

    def digest(self) -> bytes | None:
        """The digest that was written with the state after the last epoch."""
        found = self._connection.execute(_DIGEST, {"session": self.row.id}).scalar_one_or_none()
        return None if found is None else bytes(found)

    def snapshot(self) -> tuple[bytes, bytes] | None:
        """The state after the last epoch and its digest as it was written."""
        row = self._connection.execute(_SNAPSHOT, {"session": self.row.id}).one_or_none()
        return None if row is None else (bytes(row.state), bytes(row.sha256))

    def commit(
        self,
        kind: str,
        entries: Sequence[tuple[int, str]],
        folded: Folded | None = None,
        time_s: float | None = None,
    ) -> None:
        """Write log entries and what was computed from them, durably and all at once.

        Raises
        ------
        RevisionError
            If the session has moved on since it was read.
        """
        write = Write(self.row.id, self.row.revision, kind, entries, folded, time_s)
        if self._writer is not None:
            self._connection.rollback()
            self._writer.commit(write)
            return
        apply(self._connection, [write])
        if write.error is not None:
            raise write.error

    def rewrite(self, new: Rewrite) -> None:
        """Replace log, state and estimates, durably and all at once; raises RevisionError."""
        if self._writer is None:
            done = rewrite(self._connection, new)
        else:
            self._connection.rollback()
            with self._writer.alone() as connection:
                done = rewrite(connection, new)
        if not done:
            raise RevisionError


class Store:
    """Reads and writes of sessions.

    Parameters
    ----------
    engine : Engine
        As :func:`open_engine` gives it, tables up to date.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._guard = threading.Lock()
        self._writer = GroupWriter(self._transaction)
        self._locks: dict[str, tuple[threading.Lock, int]] = {}

    @contextmanager
    def stepping(self, session_id: str, key_id: str | None) -> Iterator[Step]:
        """A session to take measurements into; requests of this process take turns.

        Raises
        ------
        NotFoundError
            If there is no such session for that key.
        """
        postgres = self.engine.dialect.name == "postgresql"
        with self._turn(session_id), self.engine.connect() as connection:
            row = _found(connection, session_id, key_id, lock=postgres)
            yield Step(connection, row, None if postgres else self._writer)
            connection.commit()

    @contextmanager
    def _turn(self, session_id: str) -> Iterator[None]:
        with self._guard:
            lock, users = self._locks.get(session_id, (threading.Lock(), 0))
            self._locks[session_id] = lock, users + 1
        try:
            with lock:
                yield
        finally:
            with self._guard:
                lock, users = self._locks.pop(session_id)
                if users > 1:
                    self._locks[session_id] = lock, users - 1

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection for one consistent read."""
        with self.engine.connect() as connection:
            if self.engine.dialect.name == "postgresql":
                connection = connection.execution_options(isolation_level="REPEATABLE READ")
            yield connection

    def writing(self) -> AbstractContextManager[Connection]:
        """A connection whose changes are committed at the end.

        SQLite has one writer at a time and lets the others poll; the threads of this process
        queue up instead, so that none of them starves.
        """
        return self._writer.alone() if self.engine.dialect.name == "sqlite" else self._transaction()

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        with self.engine.connect().execution_options(write=True) as connection, connection.begin():
            yield connection

    def session(self, session_id: str, key_id: str | None, connection: Connection | None = None) -> Row[Any]:
        """A session's row.

        Raises
        ------
        NotFoundError
            If there is no such session for that key.
        """
        if connection is None:
            with self.reading() as connection:
                return self.session(session_id, key_id, connection)
        return _found(connection, session_id, key_id)

    def sessions(self, key_id: str | None, before: str | None, limit: int) -> Sequence[Row[Any]]:
        """Sessions of a key, the newest first, those older than ``before``."""
        query = sa.select(sessions).where(_owned(key_id)).order_by(sessions.c.id.desc()).limit(limit)
        if before is not None:
            query = query.where(sessions.c.id < before)
        with self.reading() as connection:
            return connection.execute(query).all()

    def create(
        self,
        session_id: str,
        key_id: str | None,
        name: str,
        config: str,
        limit: int,
        once: tuple[str, bytes] | None = None,
    ) -> str | None:
        """Add a session; its id, or None if the key has ``limit`` sessions already.

        Parameters
        ----------
        session_id, key_id, name, config
            The session.
        limit : int
            Sessions that a key may have.
        once : tuple, optional
            The request's Idempotency-Key and digest: asked for again, the session made before is named.

        Raises
        ------
        ConflictError
            If another request came with that Idempotency-Key.
        """
        try:
            return self._create(session_id, key_id, name, config, limit, once)
        except IntegrityError:  # another process made it at the same moment
            if once is None:
                raise
            return self._create(session_id, key_id, name, config, limit, once)

    def _create(
        self,
        session_id: str,
        key_id: str | None,
        name: str,
        config: str,
        limit: int,
        once: tuple[str, bytes] | None,
    ) -> str | None:
        now = datetime.now(UTC)
        held = sa.select(sa.func.count()).select_from(sessions).where(_owned(key_id))
        made_by = None if once is None else f"{key_id or ''}:{once[0]}"
        with self.writing() as connection:
            if once is not None and (known := _made(connection, made_by, once[1])) is not None:
                return known
            if connection.execute(held).scalar_one() >= limit:
                return None
            connection.execute(
                sa.insert(sessions).values(
                    id=session_id,
                    key_id=key_id,
                    name=name,
                    config=config,
                    created_at=now,
                    updated_at=now,
                    next_sweep=0,
                    next_epoch=0,
                    revision=0,
                    made_by=made_by,
                    made_from=None if once is None else once[1],
                )
            )
        return session_id

    def change(self, session_id: str, key_id: str | None, name: str | None, config: str | None) -> None:
        """Change a session's name, or its configuration as long as it has no epoch.

        Raises
        ------
        NotFoundError
            If there is no such session for that key.
        ConflictError
            If its configuration was to change and it has epochs.
        """
        with self.writing() as connection:
            row = _found(connection, session_id, key_id, lock=self.engine.dialect.name == "postgresql")
            if config is not None and row.next_epoch > 0:
                raise ConflictError(
                    f"session: expected anchors added before epoch 0, it expects epoch {row.next_epoch} next",
                    {"next_epoch": row.next_epoch},
                )
            connection.execute(
                sa.update(sessions)
                .where(sessions.c.id == session_id)
                .values(
                    name=row.name if name is None else name,
                    config=row.config if config is None else config,
                    updated_at=datetime.now(UTC),
                    revision=sessions.c.revision + 1,
                )
            )

    def delete(self, session_id: str, key_id: str | None) -> None:
        """Remove a session with everything of it; raises NotFoundError."""
        with self.writing() as connection:
            query = sa.delete(sessions).where(sessions.c.id == session_id, _owned(key_id))
            if connection.execute(query).rowcount != 1:
                raise unknown_session(session_id)

    def estimate(self, session_id: str, epoch: int, connection: Connection) -> str | None:
        """The document of an epoch's estimate."""
        query = sa.select(estimates.c.document).where(
            estimates.c.session_id == session_id, estimates.c.epoch == epoch
        )
        return connection.execute(query).scalar_one_or_none()

    def epoch_time(self, session_id: str, epoch: int) -> float | None:
        """Time of an epoch that was taken in, seconds; None if it was not."""
        query = sa.select(estimates.c.time_s).where(
            estimates.c.session_id == session_id, estimates.c.epoch == epoch
        )
        with self.reading() as connection:
            return connection.execute(query).scalar_one_or_none()

    def estimates(
        self, session_id: str, first: int, last: int, connection: Connection, limit: int | None = None
    ) -> Iterable[Row[Any]]:
        """Rows of estimates, epochs ``first`` to ``last``, ascending."""
        query = sa.select(estimates).where(
            estimates.c.session_id == session_id, estimates.c.epoch.between(first, last)
        )
        return connection.execute(query.order_by(estimates.c.epoch).limit(limit))

    def packed_estimates(self, session_id: str, last: int, connection: Connection) -> Iterable[Row[Any]]:
        """Packed estimates up to an epoch, ascending; of rows that have none their documents instead."""
        unpacked = sa.case((estimates.c.packed.is_(None), estimates.c.document)).label("document")
        query = sa.select(estimates.c.packed, unpacked).where(
            estimates.c.session_id == session_id, estimates.c.epoch <= last
        )
        return connection.execute(query.order_by(estimates.c.epoch))

    def track(
        self, session_id: str, first: int, connection: Connection, limit: int, columns: Sequence[str]
    ) -> Sequence[Row[Any]]:
        """Columns of estimates, epochs from ``first`` on, ascending."""
        query = sa.select(*(estimates.c[name] for name in columns)).where(
            estimates.c.session_id == session_id, estimates.c.epoch >= first
        )
        return connection.execute(query.order_by(estimates.c.epoch).limit(limit)).all()

    def log(self, session_id: str, kind: str, connection: Connection) -> list[str]:
        """The whole log of a kind, in order."""
        query = sa.select(measurements.c.body).where(
            measurements.c.session_id == session_id, measurements.c.kind == kind
        )
        return list(connection.execute(query.order_by(measurements.c.number)).scalars())

    def walls(self, session_id: str) -> int:
        """How many walls a session's engine has at least: those sensed at the start, or of the last epoch."""
        last = sa.select(estimates.c.walls).where(estimates.c.session_id == session_id)
        with self.reading() as connection:
            found = connection.execute(last.order_by(estimates.c.epoch.desc()).limit(1)).scalar_one_or_none()
            if found is not None:
                return int(found)
            return sum(len(json.loads(body)["walls"]) for body in self.log(session_id, "sweep", connection))

    def truth(self, session_id: str, connection: Connection) -> str | None:
        """The truth that was given to a session for comparison."""
        query = sa.select(truths).where(truths.c.session_id == session_id)
        row = connection.execute(query).one_or_none()
        if row is None or row.packed is None:
            return None if row is None else str(row.document)
        return zlib.decompress(row.packed).decode()

    def set_truth(self, session_id: str, key_id: str | None, document: str) -> None:
        """Keep a truth for comparison, replacing what was there; raises NotFoundError."""
        packed = zlib.compress(document.encode(), 1)
        with self.writing() as connection:
            self.session(session_id, key_id, connection)
            connection.execute(sa.delete(truths).where(truths.c.session_id == session_id))
            connection.execute(sa.insert(truths).values(session_id=session_id, document="", packed=packed))


def _owned(key_id: str | None) -> sa.ColumnElement[bool]:
    return sessions.c.key_id.is_(None) if key_id is None else sessions.c.key_id == key_id


def _made(connection: Connection, made_by: str | None, digest: bytes) -> str | None:
    """The session that a request made before; raises ConflictError if it was another request."""
    query = sa.select(sessions.c.id, sessions.c.made_from).where(sessions.c.made_by == made_by)
    row = connection.execute(query).one_or_none()
    if row is None:
        return None
    if bytes(row.made_from) != digest:
        raise ConflictError("Idempotency-Key: expected the request that it came with before, got another")
    return str(row.id)


def _found(connection: Connection, session_id: str, key_id: str | None, lock: bool = False) -> Row[Any]:
    """A session's row, locked if asked for; raises NotFoundError."""
    query = _OF_NO_KEY if key_id is None else _OF_KEY
    given = {"session": session_id} if key_id is None else {"session": session_id, "key": key_id}
    row = connection.execute(query.with_for_update() if lock else query, given).one_or_none()
    if row is None:
        raise unknown_session(session_id)
    return row


def unknown_session(session_id: str) -> NotFoundError:
    """The error for a session that is not there, or not the caller's: one is not told from the other."""
    return NotFoundError(f"expected a session of yours, got {session_id[:64]!r}")
