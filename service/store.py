"""The database: opening it, and the transactions on sessions.

SQLite (write-ahead log, full sync) and PostgreSQL through one code path. The
measurement log, the snapshot and the estimates of a request are one transaction, made
only if the session's revision is still the one that was read. On PostgreSQL the
session's row is locked meanwhile, so that a second process waits instead of computing in
vain; on SQLite, where a lock would stop all sessions, it finds the revision changed and
begins anew.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.util import CommandError
from sqlalchemy import URL, Connection, Engine, Row, event
from sqlalchemy.exc import DBAPIError

from service.errors import DatabaseError, NotFoundError
from service.fold import Folded, digest
from service.tables import estimates, measurements, sessions, snapshots, truths

__all__ = ["RevisionError", "Step", "Store", "opened"]

_MIGRATION_LOCK = 7_305_826  # any number that no one else locks on


class RevisionError(Exception):
    """Another process took measurements into the session meanwhile; begin anew."""


def open_engine(url: URL, lock_timeout_s: float) -> Engine:
    """A connection pool with the service's transaction rules.

    Parameters
    ----------
    url : URL
        Database.
    lock_timeout_s : float
        How long to wait for locks, and for a free connection.
    """
    if url.get_backend_name() == "postgresql":
        milliseconds = round(1000 * lock_timeout_s)
        return sa.create_engine(
            url,
            pool_size=16,
            max_overflow=48,
            pool_timeout=lock_timeout_s,
            pool_pre_ping=True,
            connect_args={
                "options": f"-c lock_timeout={milliseconds} -c timezone=utc",
                "connect_timeout": max(2, round(lock_timeout_s)),
            },
        )
    engine = sa.create_engine(
        url,
        pool_size=16,
        max_overflow=48,
        pool_timeout=lock_timeout_s,
        connect_args={"timeout": lock_timeout_s, "check_same_thread": False, "isolation_level": None},
    )

    @event.listens_for(engine, "connect")
    def _configure(connection: Any, _: object) -> None:
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        write = connection.get_execution_options().get("write", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    return engine


def migrate(engine: Engine) -> None:
    """Bring the tables up to date; processes that start together take turns."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")))
    config.set_main_option("path_separator", "os")
    with engine.connect().execution_options(write=True) as connection, connection.begin():
        if engine.dialect.name == "postgresql":
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_MIGRATION_LOCK)))
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


@contextmanager
def opened(url: URL, lock_timeout_s: float) -> Iterator[Engine]:
    """A database with its tables up to date, closed afterwards.

    Raises
    ------
    DatabaseError
        If it cannot be reached, read or written.
    """
    engine = open_engine(url, lock_timeout_s)
    try:
        try:
            migrate(engine)
        except (DBAPIError, CommandError) as error:
            reason = str(getattr(error, "orig", error)).strip().splitlines()[0]
            raise DatabaseError(
                f"database {url.render_as_string()}: expected one that can be opened: {reason}"
            ) from error
        yield engine
    finally:
        engine.dispose()


class Step:
    """A session while measurements are taken into it: what was read, and the commit."""

    def __init__(
        self,
        connection: Connection,
        row: Row[Any],
        writing: Callable[[], AbstractContextManager[Connection]] | None,
    ) -> None:
        self.row = row
        self._connection = connection
        self._writing = writing

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

    def snapshot(self) -> tuple[bytes, bytes] | None:
        """The state after the last epoch and its digest as it was written."""
        query = sa.select(snapshots.c.state, snapshots.c.sha256)
        row = self._connection.execute(query.where(snapshots.c.session_id == self.row.id)).one_or_none()
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
        if self._writing is None:
            self._write(self._connection, kind, entries, folded, time_s)
            return
        self._connection.rollback()
        with self._writing() as connection:
            self._write(connection, kind, entries, folded, time_s)

    def _write(
        self,
        connection: Connection,
        kind: str,
        entries: Sequence[tuple[int, str]],
        folded: Folded | None,
        time_s: float | None,
    ) -> None:
        row, session_id = self.row, self.row.id
        moved: dict[str, Any] = {"revision": row.revision + 1, "updated_at": datetime.now(UTC)}
        moved[f"next_{kind}"] = entries[-1][0] + 1
        if time_s is not None:
            moved["time_s"] = time_s
        update = sa.update(sessions).where(sessions.c.id == session_id, sessions.c.revision == row.revision)
        if connection.execute(update.values(**moved)).rowcount != 1:
            raise RevisionError
        connection.execute(
            sa.insert(measurements),
            [{"session_id": session_id, "kind": kind, "number": n, "body": body} for n, body in entries],
        )
        if folded is None:
            return
        connection.execute(
            sa.insert(estimates), [{"session_id": session_id, **row} for row in folded.estimates]
        )
        kept = {"epoch": entries[-1][0], "state": folded.snapshot, "sha256": digest(folded.snapshot)}
        replaced = sa.update(snapshots).where(snapshots.c.session_id == session_id)
        if connection.execute(replaced.values(**kept)).rowcount == 0:
            connection.execute(sa.insert(snapshots).values(session_id=session_id, **kept))


class Store:
    """Reads and writes of sessions.

    Parameters
    ----------
    engine : Engine
        As :func:`open_engine` gives it, tables up to date.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._guard, self._writer = threading.Lock(), threading.Lock()
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
            query = _visible(session_id, key_id)
            row = connection.execute(query.with_for_update() if postgres else query).one_or_none()
            if row is None:
                raise NotFoundError(_nothing(session_id))
            yield Step(connection, row, None if postgres else self.writing)
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

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A connection whose changes are committed at the end.

        SQLite has one writer at a time and lets the others poll; the threads of this process
        queue up instead, so that none of them starves.
        """
        alone = self._writer if self.engine.dialect.name == "sqlite" else nullcontext()
        with (
            alone,
            self.engine.connect().execution_options(write=True) as connection,
            connection.begin(),
        ):
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
        row = connection.execute(_visible(session_id, key_id)).one_or_none()
        if row is None:
            raise NotFoundError(_nothing(session_id))
        return row

    def sessions(self, key_id: str | None, before: str | None, limit: int) -> Sequence[Row[Any]]:
        """Sessions of a key, the newest first, those older than ``before``."""
        query = sa.select(sessions).where(_owned(key_id)).order_by(sessions.c.id.desc()).limit(limit)
        if before is not None:
            query = query.where(sessions.c.id < before)
        with self.reading() as connection:
            return connection.execute(query).all()

    def create(self, session_id: str, key_id: str | None, name: str, config: str, limit: int) -> bool:
        """Add a session; False if the key has ``limit`` sessions already."""
        now = datetime.now(UTC)
        held = sa.select(sa.func.count()).select_from(sessions).where(_owned(key_id))
        with self.writing() as connection:
            if connection.execute(held).scalar_one() >= limit:
                return False
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
                )
            )
        return True

    def delete(self, session_id: str, key_id: str | None) -> None:
        """Remove a session with everything of it; raises NotFoundError."""
        with self.writing() as connection:
            query = sa.delete(sessions).where(sessions.c.id == session_id, _owned(key_id))
            if connection.execute(query).rowcount != 1:
                raise NotFoundError(_nothing(session_id))

    def estimate(self, session_id: str, epoch: int, connection: Connection) -> str | None:
        """The document of an epoch's estimate."""
        query = sa.select(estimates.c.document).where(
            estimates.c.session_id == session_id, estimates.c.epoch == epoch
        )
        return connection.execute(query).scalar_one_or_none()

    def estimates(
        self, session_id: str, first: int, last: int, connection: Connection, limit: int | None = None
    ) -> Iterable[Row[Any]]:
        """Rows of estimates, epochs ``first`` to ``last``, ascending."""
        query = sa.select(estimates).where(
            estimates.c.session_id == session_id, estimates.c.epoch.between(first, last)
        )
        return connection.execute(query.order_by(estimates.c.epoch).limit(limit))

    def log(self, session_id: str, kind: str, connection: Connection) -> list[str]:
        """The whole log of a kind, in order."""
        query = sa.select(measurements.c.body).where(
            measurements.c.session_id == session_id, measurements.c.kind == kind
        )
        return list(connection.execute(query.order_by(measurements.c.number)).scalars())

    def truth(self, session_id: str, connection: Connection) -> str | None:
        """The truth that was given to a session for comparison."""
        query = sa.select(truths.c.document).where(truths.c.session_id == session_id)
        return connection.execute(query).scalar_one_or_none()

    def set_truth(self, session_id: str, key_id: str | None, document: str) -> None:
        """Keep a truth for comparison, replacing what was there; raises NotFoundError."""
        with self.writing() as connection:
            self.session(session_id, key_id, connection)
            connection.execute(sa.delete(truths).where(truths.c.session_id == session_id))
            connection.execute(sa.insert(truths).values(session_id=session_id, document=document))


def _owned(key_id: str | None) -> sa.ColumnElement[bool]:
    return sessions.c.key_id.is_(None) if key_id is None else sessions.c.key_id == key_id


def _visible(session_id: str, key_id: str | None) -> sa.Select[Any]:
    return sa.select(sessions).where(sessions.c.id == session_id, _owned(key_id))


def _nothing(session_id: str) -> str:
    return f"expected a session of yours, got {session_id[:64]!r}"
