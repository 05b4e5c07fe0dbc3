"""Files in: raw channels, datasets, measurement files; and the shipped example."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import JSONResponse

from service.api.context import CallerDep, Context, ContextDep, SessionAccess, SessionDep
from service.api.files_in import take_channels, take_dataset, take_upload
from service.api.jobs import JobKind, submit_job
from service.api.openapi import described
from service.api.routes.measurements import answered
from service.api.routes.sessions import Once, OnceDep, read
from service.messages.answers import EpochsAnswer, Job, Session
from service.messages.channels import ChannelsQuery
from service.session.example import ExampleTask
from service.session.workers import Lane

__all__ = ["FILE", "router"]

router = APIRouter(prefix="/v1", tags=["files"])

FILE = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


_ASYNC = "respond-async"
_ACCEPTED: dict[int | str, Any] = {
    202: {"model": Job, "description": "Kept as a job, to be read at `Location` (`Prefer: respond-async`)"}
}


async def _later(
    prefer: Annotated[
        str | None,
        Header(
            max_length=200, description="`respond-async`: the file is kept as a job, and answered at once."
        ),
    ] = None,
) -> bool:
    """Whether the client would rather not wait (RFC 7240)."""
    return prefer is not None and _ASYNC in {part.strip().lower() for part in prefer.split(",")}


LaterDep = Annotated[bool, Depends(_later)]


@router.post(
    "/sessions/{session_id}/channels",
    summary="Add raw channels",
    response_class=Response,
    responses={**described(EpochsAnswer), **_ACCEPTED},
    openapi_extra=FILE,
)
async def channels(
    request: Request,
    session: SessionDep,
    here: ContextDep,
    radio: Annotated[ChannelsQuery, Query()],
    once: OnceDep,
    later: LaterDep,
) -> Response:
    """Channel frequency responses as netCDF or npz; their paths are estimated and taken in as epochs.

    Variables: `cfr_re`, `cfr_im` (epoch, anchor, [snapshot,] [anchor antenna,] antenna, tone), `time_s`,
    `epoch`, `anchor`, `tone_offset_hz`: a passive shard of `hapslam trace` is such a file. All antennas and
    snapshots are used together. `elements` says that the agent's antennas are an array; if that array tells
    all azimuths apart (`lying`), directions of arrival are measured too.
    """
    if later:
        await here.run(here.store.session, session.id, session.key_id)
        parameters = {"session": session.id, "radio": radio.model_dump()}
        return await _accepted(request, here, session.key_id, "channels", parameters, once)
    return answered(*await take_channels(here, session, await request.body(), radio))


@router.post(
    "/sessions/{session_id}/datasets",
    summary="Add a dataset",
    response_class=Response,
    responses={**described(EpochsAnswer), **_ACCEPTED},
    openapi_extra=FILE,
)
async def datasets(
    request: Request, session: SessionDep, here: ContextDep, once: OnceDep, later: LaterDep
) -> Response:
    """A zipped dataset of `hapslam trace` (its channels are estimated), or a measurement file."""
    if later:
        await here.run(here.store.session, session.id, session.key_id)
        return await _accepted(request, here, session.key_id, "dataset", {"session": session.id}, once)
    return answered(*await take_dataset(here, session, await request.body()))


@router.post(
    "/uploads",
    status_code=201,
    summary="Make a session from a file",
    openapi_extra=FILE,
    responses={201: {"model": Session}, **_ACCEPTED},
    response_class=Response,
)
async def uploads(
    request: Request,
    here: ContextDep,
    who: CallerDep,
    once: OnceDep,
    later: LaterDep,
    name: Annotated[str, Query(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = "",
    method: Annotated[str, Query(max_length=50)] = "hybrid",
    engine: Annotated[str, Query(max_length=50)] = "gaussian",
    seed: Annotated[int, Query(ge=0, le=2**63 - 1)] = 1,
) -> Response:
    """A measurement file, or a zipped dataset: a session is made for it and takes all of it in.

    With an `Idempotency-Key` the same request again makes no other session.
    """
    stated = {"name": name, "method": method, "engine": engine, "seed": seed}
    if later:
        return await _accepted(request, here, who.key_id, "upload", stated, once)
    session = await take_upload(here, who.key_id, await request.body(), stated, once)
    headers = {"Location": f"/v1/sessions/{session.id}"}
    return JSONResponse(await read(session, here), 201, headers)


async def _accepted(
    request: Request,
    here: Context,
    key_id: str | None,
    kind: JobKind,
    parameters: dict[str, Any],
    once: Once,
) -> Response:
    """The answer to a file that is kept as a job."""
    job = await submit_job(here, key_id, kind, parameters, await request.body(), once)
    headers = {"Location": f"/v1/jobs/{job['id']}", "Preference-Applied": _ASYNC, "Retry-After": "1"}
    return JSONResponse(job, 202, headers)


@router.get("/example", summary="The shipped example", response_class=Response)
async def shipped_example(
    who: CallerDep, here: ContextDep, seed: Annotated[int, Query(ge=0, le=2**31)] = 1
) -> Response:
    """A simulated walk through an L-shaped room, as the requests that send it to this service."""
    return Response(
        await here.work(Lane.BULK, SessionAccess("", who.key_id), ExampleTask(seed)),
        media_type="application/json",
    )
