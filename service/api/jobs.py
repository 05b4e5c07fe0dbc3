"""Jobs: files that are answered for at once, `202`, and taken in afterwards, whatever happens to processes.

A job is on disk before it is answered. A process that works on one leases it and renews the lease; a job
whose process was killed is taken up by another, or by the next one, and since sessions are made once and
epochs are known by their numbers, that changes nothing.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Literal

import structlog
from sqlalchemy import Row
from sqlalchemy.exc import SQLAlchemyError

from estimator.errors import HapslamError
from service.api.context import Context, SessionAccess
from service.api.files_in import take_channels, take_dataset, take_upload
from service.api.problems import problem
from service.errors import BusyError, DrainingError
from service.messages.channels import ChannelsQuery
from service.messages.documents import dump
from service.storage.jobs import JobStore

__all__ = ["JobKind", "JobRunner", "job_document", "submit_job"]

JobKind = Literal["upload", "dataset", "channels"]
_POLL_S = 0.5
_ATTEMPTS = 3  # a job over which as many processes died is given up


async def submit_job(
    here: Context,
    key_id: str | None,
    kind: JobKind,
    parameters: Mapping[str, Any],
    body: bytes,
    once: tuple[str, bytes] | None,
) -> dict[str, Any]:
    """Keep a job on disk; its document. The same `Idempotency-Key` and request names the same job."""
    if once is None:
        job_id = os.urandom(16).hex()
    else:
        job_id = hashlib.sha256(f"{key_id or ''}:{once[0]}:".encode() + once[1]).hexdigest()[:32]
    jobs, most = here.jobs, here.settings.max_jobs_per_key
    await here.run(jobs.submit, job_id, key_id, kind, dump(dict(parameters)), body, most)
    return job_document(await here.run(jobs.read, job_id, key_id))


def job_document(row: Row[Any]) -> dict[str, Any]:
    """A job as the service shows it."""
    answer = json.loads(row.answer) if row.answer else {}
    return {
        "id": row.id,
        "kind": row.kind,
        "state": "queued" if row.state == "coming" else row.state,
        "created_at": _instant(row.created_at),
        "updated_at": _instant(row.updated_at),
        "session": answer.get("session") or json.loads(row.parameters).get("session"),
        "last_epoch": answer.get("last_epoch"),
        "problem": answer.get("problem"),
    }


class JobRunner:
    """Works on jobs of this database, a few at a time, as long as the application runs.

    Parameters
    ----------
    here : Context
        What the routes share.
    """

    def __init__(self, here: Context) -> None:
        self._here = here
        self._tasks = [asyncio.create_task(self._work()) for _ in range(here.settings.bulk_workers)]

    async def stop(self) -> None:
        """Stop; what is in work is given back."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _work(self) -> None:
        while True:
            try:
                row = None if self._here.draining else await self._here.run(self._here.jobs.claim)
            except SQLAlchemyError:
                structlog.get_logger().warning("no jobs for the moment, the database does not answer")
                row = None
            if row is None:
                await asyncio.sleep(_POLL_S)
            else:
                await self._do(row)

    async def _do(self, row: Row[Any]) -> None:
        jobs: JobStore = self._here.jobs
        lease = asyncio.create_task(self._renewed(row.id))
        try:
            if row.attempts > _ATTEMPTS:
                raise HapslamError(
                    f"expected a file that can be taken in, {_ATTEMPTS} processes died over it"
                )
            answer = await self._taken(row)
            await self._here.run(jobs.finish, row.id, "done", dump(answer))
        except (BusyError, DrainingError) as error:
            await self._here.run(jobs.release, row.id)
            await asyncio.sleep(getattr(error, "retry_after_s", _POLL_S))
        except SQLAlchemyError:  # the lease runs out, the job comes again
            structlog.get_logger().warning("job interrupted by the database", job=row.id)
        except HapslamError as error:
            told = json.loads(bytes(problem(error, row.id).body))
            await self._here.run(jobs.finish, row.id, "failed", dump({"problem": told}))
        finally:
            lease.cancel()

    async def _renewed(self, job_id: str) -> None:
        while True:
            await asyncio.sleep(self._here.jobs.terms.lease_s / 3.0)
            await self._here.run(self._here.jobs.renew, job_id)

    async def _taken(self, row: Row[Any]) -> dict[str, Any]:
        here, parameters = self._here, json.loads(row.parameters)
        body = await here.run(here.jobs.body, row.id)
        if row.kind == "upload":
            once = f"job:{row.id}", bytes.fromhex(row.id)
            session = await take_upload(here, row.key_id, body, parameters, once)
            return {"session": session.id}
        session = SessionAccess(parameters["session"], row.key_id)
        if row.kind == "dataset":
            taken, _ = await take_dataset(here, session, body)
        else:
            taken, _ = await take_channels(here, session, body, ChannelsQuery(**parameters["radio"]))
        return {"session": session.id, "last_epoch": taken.last}


def _instant(value: datetime) -> str:
    aware = value if value.tzinfo else value.replace(tzinfo=UTC)
    return aware.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
