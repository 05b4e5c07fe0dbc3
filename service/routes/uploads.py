"""Files in: raw channels, datasets, measurement files; and the shipped example."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from estimator.errors import FileFormatError
from service.context import CallerDep, Context, ContextDep, SessionAccess, SessionDep
from service.errors import ConflictError, TooLargeError, WorkerDiedError
from service.example import example
from service.push import session_entry
from service.raw_channels import ChannelsTask
from service.routes.measurements import answer, take
from service.routes.sessions import create_session, read
from service.schemas import ChannelsQuery, SessionRequest
from service.sessions import Taken, take_sweep
from service.uploads import FileTask, Unpacked
from service.workers import Task

__all__ = ["router"]

router = APIRouter(prefix="/v1", tags=["files"])

_FILE = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post(
    "/sessions/{session_id}/channels",
    summary="Add raw channels",
    response_class=Response,
    openapi_extra=_FILE,
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
    )
    epochs = await _unpacked(here, session.id, task)
    if len(epochs) > here.settings.max_epochs_per_request:
        raise TooLargeError(
            f"epoch: expected at most {here.settings.max_epochs_per_request}, got {len(epochs)}"
        )
    return answer(here, session, *await here.run(take, here, session, epochs))


@router.post(
    "/sessions/{session_id}/datasets",
    summary="Add a dataset",
    response_class=Response,
    openapi_extra=_FILE,
)
async def datasets(request: Request, session: SessionDep, here: ContextDep) -> Response:
    """A zipped dataset of `hapslam trace` (its channels are estimated), or a measurement file."""
    await here.run(here.store.session, session.id, session.key_id)
    task = FileTask(await request.body(), here.settings.max_unpacked_bytes)
    found = await _unpacked(here, session.id, task)
    return answer(here, session, *await here.run(_take_all, here, session, found))


@router.post("/uploads", status_code=201, summary="Make a session from a file", openapi_extra=_FILE)
async def uploads(
    request: Request,
    response: Response,
    here: ContextDep,
    who: CallerDep,
    name: Annotated[str, Query(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = "",
    method: Annotated[str, Query(max_length=50)] = "hybrid",
    engine: Annotated[str, Query(max_length=50)] = "gaussian",
    seed: Annotated[int, Query(ge=0, le=2**63 - 1)] = 1,
) -> dict[str, Any]:
    """A measurement file, or a zipped dataset: a session is made for it and takes all of it in."""
    task = FileTask(await request.body(), here.settings.max_unpacked_bytes)
    found = await _unpacked(here, str(seed), task)
    entry = session_entry(found.measurements, name=name, method=method, engine=engine, seed=seed)
    if found.truth is not None:
        entry["start_frame"] = found.truth["start_frame"]
    try:
        wanted = SessionRequest.model_validate(entry)
    except ValueError as error:
        raise FileFormatError(f"file: expected measurements that make a session: {error}") from error
    session = await create_session(wanted, here, who)
    response.headers["Location"] = f"/v1/sessions/{session.id}"
    try:
        if found.measurements.epochs:
            await here.run(_take_all, here, session, found)
    except Exception:
        await here.run(here.store.delete, session.id, session.key_id)
        raise
    return await read(session, here)


@router.get("/example", summary="The shipped example")
async def shipped_example(
    who: CallerDep, here: ContextDep, seed: Annotated[int, Query(ge=0, le=2**31)] = 1
) -> dict[str, Any]:
    """A simulated walk through an L-shaped room, as the requests that send it to this service."""
    return await here.run(example, seed)


async def _unpacked(here: Context, key: str, task: Task[Any]) -> Any:
    try:
        return await here.run(here.pool.run, key, task)
    except WorkerDiedError as error:
        raise FileFormatError("file: expected one that can be read, its reader crashed over it") from error


def _take_all(here: Context, session: SessionAccess, found: Unpacked) -> tuple[Taken, str]:
    """Take a file's walls and epochs into a session whose anchors they name."""
    row = here.store.session(session.id, session.key_id)
    config = json.loads(row.config)
    measurements = found.measurements
    for what, expected, got in (
        ("anchors", config["anchors"], list(measurements.anchors)),
        ("carrier_hz", config["carrier_hz"], measurements.carrier_hz),
    ):
        if expected != got:
            raise ConflictError(f"{what}: expected those of the session, {expected}, got {got}")
    if not measurements.epochs:
        raise FileFormatError("file: expected at least one epoch, got none")
    if len(measurements.epochs) > here.settings.max_epochs_per_request:
        raise TooLargeError(
            f"epochs: expected at most {here.settings.max_epochs_per_request}, got {len(measurements.epochs)}"
        )
    limit = here.settings.max_walls
    take_sweep(here.store, session.id, session.key_id, 0, measurements.walls, limit)
    if found.truth is not None:
        here.store.set_truth(session.id, session.key_id, json.dumps(found.truth))
    return take(here, session, measurements.epochs)
