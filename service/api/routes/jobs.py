"""Jobs: what became of files that were answered for at once."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query

from service.api.context import CallerDep, ContextDep
from service.api.jobs import job_document
from service.api.openapi import described
from service.errors import ForbiddenError
from service.messages.answers import Job, JobList

__all__ = ["router"]

router = APIRouter(prefix="/v1/jobs", tags=["files"])


@router.get("", summary="List jobs", operation_id="list_jobs", responses=described(JobList))
async def list_jobs(
    here: ContextDep, who: CallerDep, limit: Annotated[int, Query(ge=1, le=500)] = 50
) -> dict[str, Any]:
    """Jobs of the caller's key, the newest first; what is done is forgotten after a week."""
    if who.session_id is not None:
        raise ForbiddenError("expected a key, got a share of one session")
    return {"jobs": [job_document(row) for row in await here.run(here.jobs.list, who.key_id, limit)]}


@router.get("/{job_id}", summary="Read a job", operation_id="read_job", responses=described(Job))
async def read_job(
    here: ContextDep, who: CallerDep, job_id: Annotated[str, Path(pattern="^[0-9a-f]{32}$")]
) -> dict[str, Any]:
    """How far a job is: `queued`, `running`, `done` with its session, or `failed` with a problem."""
    if who.session_id is not None:
        raise ForbiddenError("expected a key, got a share of one session")
    return job_document(await here.run(here.jobs.read, job_id, who.key_id))
