"""Jobs on disk: a file that is to be taken in, who works on it, and what became of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Row

from service.errors import NotFoundError, TooManyError
from service.storage.store import Store
from service.storage.tables import job_parts, jobs

__all__ = ["JobStore", "JobTerms"]

_PART_BYTES = 2**20
_OPEN = ("coming", "queued", "running")


@dataclass(frozen=True)
class JobTerms:
    """How long jobs are kept and leased.

    Parameters
    ----------
    lease_s : float
        How long a process that was not heard of keeps a job, seconds.
    kept_days : float
        How long what became of a job can be read.
    coming_s : float
        How long a file may take to be written, seconds.
    """

    lease_s: float = 15.0
    kept_days: float = 7.0
    coming_s: float = 600.0


class JobStore:
    """Reads and writes of jobs.

    Parameters
    ----------
    store : Store
        The database.
    terms : JobTerms, optional
        How long they are kept and leased.
    """

    def __init__(self, store: Store, terms: JobTerms | None = None) -> None:
        self._store, self.terms = store, terms or JobTerms()

    def submit(
        self, job_id: str, key_id: str | None, kind: str, parameters: str, body: bytes, most: int
    ) -> None:
        """Keep a job; when this returns it is on disk. One that is there already is left as it is.

        Raises
        ------
        TooManyError
            If the key has ``most`` jobs that are not done.
        """
        now = datetime.now(UTC)
        with self._store.writing() as connection:
            self._forget(connection, now)
            found = connection.execute(
                sa.select(jobs.c.state).where(jobs.c.id == job_id)
            ).scalar_one_or_none()
            if found not in (None, "coming"):
                return
            open_ = sa.select(sa.func.count()).where(_owned(key_id), jobs.c.state.in_(_OPEN))
            if found is None and connection.execute(open_).scalar_one() >= most:
                raise TooManyError(f"expected at most {most} jobs of a key that are not done; wait for some")
            connection.execute(sa.delete(jobs).where(jobs.c.id == job_id))
            connection.execute(
                sa.insert(jobs).values(
                    id=job_id,
                    key_id=key_id,
                    kind=kind,
                    parameters=parameters,
                    state="coming",
                    created_at=now,
                    updated_at=now,
                    attempts=0,
                )
            )
        for number, first in enumerate(range(0, len(body), _PART_BYTES)):
            part = body[first : first + _PART_BYTES]
            with self._store.writing() as connection:
                connection.execute(sa.insert(job_parts).values(job_id=job_id, number=number, content=part))
        self._change(job_id, state="queued")

    def _forget(self, connection: sa.Connection, now: datetime) -> None:
        """Forget jobs that are long done, and files that never came whole."""
        done, coming = timedelta(days=self.terms.kept_days), timedelta(seconds=self.terms.coming_s)
        connection.execute(
            sa.delete(jobs).where(
                sa.or_(
                    jobs.c.state.in_(("done", "failed")) & (jobs.c.updated_at < now - done),
                    (jobs.c.state == "coming") & (jobs.c.updated_at < now - coming),
                )
            )
        )

    def claim(self) -> Row[Any] | None:
        """The oldest job that nobody works on, leased to the caller; None if there is none."""
        now = datetime.now(UTC)
        free = sa.or_(jobs.c.state == "queued", (jobs.c.state == "running") & (jobs.c.leased_until < now))
        with self._store.reading() as connection:
            found = connection.execute(sa.select(jobs.c.id).where(free).order_by(jobs.c.created_at).limit(1))
            job_id = found.scalar_one_or_none()
        if job_id is None:
            return None
        with self._store.writing() as connection:
            leased = (
                sa.update(jobs)
                .where(jobs.c.id == job_id, free)
                .values(
                    state="running",
                    leased_until=now + timedelta(seconds=self.terms.lease_s),
                    attempts=jobs.c.attempts + 1,
                    updated_at=now,
                )
            )
            if connection.execute(leased).rowcount != 1:  # another process was first
                return None
            return connection.execute(sa.select(jobs).where(jobs.c.id == job_id)).one()

    def body(self, job_id: str) -> bytes:
        """A job's file."""
        query = sa.select(job_parts.c.content).where(job_parts.c.job_id == job_id)
        with self._store.reading() as connection:
            parts = connection.execute(query.order_by(job_parts.c.number)).scalars()
            return b"".join(bytes(part) for part in parts)

    def renew(self, job_id: str) -> None:
        """Keep a job that is worked on."""
        self._change(job_id, leased_until=datetime.now(UTC) + timedelta(seconds=self.terms.lease_s))

    def release(self, job_id: str) -> None:
        """Give a job back, to be worked on later; the attempt does not count."""
        self._change(job_id, state="queued", leased_until=None, attempts=jobs.c.attempts - 1)

    def finish(self, job_id: str, state: str, answer: str) -> None:
        """Note what became of a job, ``"done"`` or ``"failed"``, and forget its file."""
        self._change(job_id, state=state, answer=answer, leased_until=None)
        with self._store.writing() as connection:
            connection.execute(sa.delete(job_parts).where(job_parts.c.job_id == job_id))

    def read(self, job_id: str, key_id: str | None) -> Row[Any]:
        """A job's row.

        Raises
        ------
        NotFoundError
            If there is no such job of that key.
        """
        with self._store.reading() as connection:
            row = connection.execute(sa.select(jobs).where(jobs.c.id == job_id, _owned(key_id))).one_or_none()
        if row is None:
            raise NotFoundError(f"job: expected the id of a job of yours, got {job_id[:64]!r}")
        return row

    def list(self, key_id: str | None, limit: int) -> Sequence[Row[Any]]:
        """Jobs of a key, the newest first."""
        query = sa.select(jobs).where(_owned(key_id)).order_by(jobs.c.created_at.desc()).limit(limit)
        with self._store.reading() as connection:
            return connection.execute(query).all()

    def _change(self, job_id: str, **values: Any) -> None:
        with self._store.writing() as connection:
            change = sa.update(jobs).where(jobs.c.id == job_id)
            connection.execute(change.values(updated_at=datetime.now(UTC), **values))


def _owned(key_id: str | None) -> sa.ColumnElement[bool]:
    return jobs.c.key_id.is_(None) if key_id is None else jobs.c.key_id == key_id
