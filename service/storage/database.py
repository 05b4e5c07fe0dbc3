"""The database: opening it and bringing its tables up to date.

SQLite (write-ahead log, full sync) and PostgreSQL.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import URL, Connection, Engine, event
from sqlalchemy.exc import DBAPIError

from service.errors import DatabaseError

__all__ = ["open_engine", "opened"]

_MIGRATION_LOCK = 7_305_826  # any number that no one else locks on


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
    from alembic import command  # slow to import
    from alembic.config import Config

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
    from alembic.util import CommandError

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
