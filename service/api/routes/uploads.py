"""Files in: raw channels, datasets, measurement files; and the shipped example."""

from __future__ import annotations

import json
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Query, Request, Response

from estimator.errors import FileFormatError
from service.api.context import CallerDep, Context, ContextDep, SessionAccess, SessionDep
from service.api.openapi import described
from service.api.routes.measurements import limits, take, take_walls
from service.api.routes.sessions import OnceDep, create_session, read
from service.errors import ConflictError, WorkerDiedError
from service.messages.answers import EpochsAnswer, Session
from service.messages.channels import ChannelsQuery
from service.messages.session_requests import SessionRequest
from service.session.example import ExampleTask
from service.session.files import FileTask, Unpacked
from service.session.raw_channels import ChannelsTask
from service.session.tasks import Task
from service.session.workers import Lane

__all__ = ["FILE", "router", "unpacked"]

T = TypeVar("T")
router = APIRouter(prefix="/v1", tags=["files"])

FILE = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post(
    "/sessions/{session_id}/channels",
    summary="Add raw channels",
    response_class=Response,
    responses=described(EpochsAnswer),
    openapi_extra=FILE,
)
async def channels(
    request: Request,
    session: SessionDep,
    here: ContextDep,
    radio: Annotated[ChannelsQuery, Query()],
) -> Response:
    """Channel frequency responses as netCDF or npz; their paths are estimated and taken in as epochs.

    Variables: `cfr_re`, `cfr_im` (epoch, anchor, [snapshot,] [anchor antenna,] antenna, tone), `time_s`,
    `epoch`, `anchor`, `tone_offset_hz`: a passive shard of `hapslam trace` is such a file. All antennas and
    snapshots are used together. `elements` says that the agent's antennas are an array; if that array tells
    all azimuths apart (`lying`), directions of arrival are measured too.
    """
    config = json.loads((await here.run(here.store.session, session.id, session.key_id)).config)
    task = ChannelsTask(
        await request.body(),
        tuple(config["anchors"]),
        config["carrier_hz"],
        radio.noise_variance,
        radio.array(),
        radio.orientation == "fixed",
        here.settings.max_unpacked_bytes,
        limits(here),
    )
    return await take(here, session, await unpacked(here, session, task))


@router.post(
    "/sessions/{session_id}/datasets",
    summary="Add a dataset",
    response_class=Response,
    responses=described(EpochsAnswer),
    openapi_extra=FILE,
)
async def datasets(request: Request, session: SessionDep, here: ContextDep) -> Response:
    """A zipped dataset of `hapslam trace` (its channels are estimated), or a measurement file."""
    await here.run(here.store.session, session.id, session.key_id)
    task = FileTask(await request.body(), here.settings.max_unpacked_bytes, limits(here))
    return await _take_all(here, session, await unpacked(here, session, task))


@router.post(
    "/uploads",
    status_code=201,
    summary="Make a session from a file",
    openapi_extra=FILE,
    responses={201: {"model": Session}},
)
async def uploads(
    request: Request,
    response: Response,
    here: ContextDep,
    who: CallerDep,
    once: OnceDep,
    name: Annotated[str, Query(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = "",
    method: Annotated[str, Query(max_length=50)] = "hybrid",
    engine: Annotated[str, Query(max_length=50)] = "gaussian",
    seed: Annotated[int, Query(ge=0, le=2**63 - 1)] = 1,
) -> dict[str, Any]:
    """A measurement file, or a zipped dataset: a session is made for it and takes all of it in.

    With an `Idempotency-Key` the same request again makes no other session.
    """
    task = FileTask(await request.body(), here.settings.max_unpacked_bytes, limits(here))
    found = await unpacked(here, SessionAccess("", who.key_id), task)
    entry = {**found.session, "name": name, "method": method, "engine": engine, "seed": seed}
    try:
        wanted = SessionRequest.model_validate(entry)
    except ValueError as error:
        raise FileFormatError(f"file: expected measurements that make a session: {error}") from error
    session, new = await create_session(wanted, here, who, once)
    response.headers["Location"] = f"/v1/sessions/{session.id}"
    try:
        if found.epochs:
            await _take_all(here, session, found)
    except Exception:
        if new:
            await here.run(here.store.delete, session.id, session.key_id)
        raise
    return await read(session, here)


@router.get("/example", summary="The shipped example", response_class=Response)
async def shipped_example(
    who: CallerDep, here: ContextDep, seed: Annotated[int, Query(ge=0, le=2**31)] = 1
) -> Response:
    """A simulated walk through an L-shaped room, as the requests that send it to this service."""
    return Response(
        await here.work(Lane.BULK, SessionAccess("", who.key_id), ExampleTask(seed)),
        media_type="application/json",
    )


async def unpacked(here: Context, session: SessionAccess, task: Task[T]) -> T:
    """What a file holds, read by a worker."""
    try:
        return await here.work(Lane.BULK, session, task)
    except WorkerDiedError as error:
        raise FileFormatError("file: expected one that can be read, its reader crashed over it") from error


async def _take_all(here: Context, session: SessionAccess, found: Unpacked) -> Response:
    """Take a file's walls and epochs into a session whose anchors they name."""
    row = await here.run(here.store.session, session.id, session.key_id)
    config = json.loads(row.config)
    for what in ("anchors", "carrier_hz"):
        if config[what] != found.session[what]:
            raise ConflictError(
                f"{what}: expected those of the session, {config[what]}, got {found.session[what]}"
            )
    if not found.epochs:
        raise FileFormatError("file: expected at least one epoch, got none")
    await take_walls(here, session, 0, list(found.walls), Response())
    if found.truth is not None:
        await here.run(here.store.set_truth, session.id, session.key_id, found.truth)
    return await take(here, session, found.epochs)
