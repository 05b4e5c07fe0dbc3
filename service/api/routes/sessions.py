"""Sessions: make, list, read, delete."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from sqlalchemy import Row

from estimator.errors import InputError
from estimator.slam.methods import PAIRS
from service.api.context import CallerDep, Context, ContextDep, SessionAccess, SessionDep
from service.api.openapi import described
from service.errors import TooLargeError, TooManyError
from service.messages.answers import Method, Session, SessionPage, Share
from service.messages.documents import dump
from service.messages.session_requests import SessionChange, SessionRequest
from service.messages.truth import Truth
from service.session.anchors_added import add_anchors
from service.session.bodies import ParseTask, TruthTask, json_content
from service.session.fold import engine_of
from service.session.sessions import new_session_id
from service.session.workers import Lane

__all__ = ["Once", "OnceDep", "create_session", "read", "router", "session_document"]

router = APIRouter(prefix="/v1", tags=["sessions"])
Once = tuple[str, bytes] | None
_TRUTH: dict[int | str, Any] = {
    200: {
        "description": "The truth, or null",
        "content": {
            "application/json": {
                "schema": {"anyOf": [{"$ref": "#/components/schemas/Truth"}, {"type": "null"}]}
            }
        },
    }
}


async def _once(
    request: Request,
    here: ContextDep,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200, pattern="^[!-~]+$")] = None,
) -> Once:
    """The request's Idempotency-Key, and a digest of all that the request asks for."""
    if idempotency_key is None:
        return None
    asked = f"{request.url.path}?{request.url.query}\n".encode()
    return idempotency_key, await here.run(_digest, asked, await request.body())


def _digest(*parts: bytes) -> bytes:
    found = hashlib.sha256()
    for part in parts:
        found.update(part)
    return found.digest()


OnceDep = Annotated[Once, Depends(_once)]


@router.get(
    "/methods", summary="What a session's method and engine may be", responses={200: {"model": list[Method]}}
)
async def methods(who: CallerDep) -> list[dict[str, str]]:
    """Pairs of method (what is known and sensed) and engine (how inference is done)."""
    return [{"method": method, "engine": engine} for method, engine in PAIRS]


@router.post(
    "/sessions",
    status_code=201,
    summary="Make a session",
    operation_id="create_session",
    openapi_extra=json_content(SessionRequest),
    responses={201: {"model": Session}},
)
async def create(
    request: Request, here: ContextDep, who: CallerDep, response: Response, once: OnceDep
) -> dict[str, Any]:
    """Make a session; measurements go to the address in ``Location``.

    With an `Idempotency-Key` the same request again makes no other session.
    """
    body, nowhere = await request.body(), SessionAccess("", who.key_id)
    wanted = await here.parsed(nowhere, body, ParseTask(SessionRequest, body))
    session, _ = await create_session(wanted, here, who.key_id, once)
    response.headers["Location"] = f"/v1/sessions/{session.id}"
    return await read(session, here)


async def create_session(
    request: SessionRequest, here: Context, key_id: str | None, once: Once = None
) -> tuple[SessionAccess, bool]:
    """Make a session of a key, within the limits, or find the one that the request made before.

    Returns
    -------
    SessionAccess
        The session.
    bool
        Whether it is new.
    """
    _check_anchors(request, here)
    config = request.config()
    await here.run(engine_of, config)
    limit, new = here.settings.max_sessions_per_key, new_session_id()
    made = await here.run(here.store.create, new, key_id, request.name, dump(config), limit, once)
    if made is None:
        raise TooManyError(f"expected at most {limit} sessions of a key; delete some")
    return SessionAccess(made, key_id), made == new


def _check_anchors(request: SessionRequest, here: Context) -> None:
    most = here.settings.max_anchors
    if len(request.anchors) > most:
        raise TooLargeError(f"anchors: expected at most {most}, got {len(request.anchors)}")


@router.get("/sessions", summary="List sessions", responses=described(SessionPage))
async def list_sessions(
    here: ContextDep,
    who: CallerDep,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
    before: Annotated[
        str | None, Query(pattern="^[0-9a-f]{32}$", description="`next` of the page before.")
    ] = None,
) -> dict[str, Any]:
    """Sessions of the caller's key, the newest first, a page at a time."""
    if who.session_id is not None:
        only = await here.run(here.store.session, who.session_id, who.key_id)
        return {"sessions": [session_document(only)], "next": None}
    rows = await here.run(here.store.sessions, who.key_id, before, limit)
    return {
        "sessions": [session_document(row) for row in rows],
        "next": rows[-1].id if len(rows) == limit else None,
    }


@router.get(
    "/sessions/{session_id}",
    summary="Read a session",
    operation_id="read_session",
    responses=described(Session),
)
async def read(session: SessionDep, here: ContextDep) -> dict[str, Any]:
    """The session's configuration, and what it expects next."""
    return session_document(await here.run(here.store.session, session.id, session.key_id))


@router.patch(
    "/sessions/{session_id}",
    summary="Rename a session, add anchors",
    operation_id="change_session",
    openapi_extra=json_content(SessionChange),
    responses=described(Session),
)
async def change(request: Request, session: SessionDep, here: ContextDep) -> dict[str, Any]:
    """Change a session's name, or add anchors and what is known of them.

    A session that has epochs is computed anew, as if the new anchors had been there without being heard;
    until that is done it stays as it was.
    """
    body = await request.body()
    wanted = await here.parsed(session, body, ParseTask(SessionChange, body))

    def changed(before: Mapping[str, Any]) -> dict[str, Any]:
        try:
            request = wanted.changed(before)
        except ValueError as error:
            raise InputError(str(error)) from error
        _check_anchors(request, here)
        config = request.config()
        engine_of(config)
        return config

    config, most = None, here.settings.max_epochs_per_request
    if not wanted.renames_only:
        row = await here.run(here.store.session, session.id, session.key_id)
        new = await here.run(changed, json.loads(row.config))
        if row.next_epoch == 0:
            config = dump(new)
        else:
            await here.workers.hold(
                Lane.BULK,
                session.key_id,
                session.id,
                lambda worker: add_anchors(here.store, worker, session.id, session.key_id, changed, most),
            )
            here.pictures.forget(session.id)
        here.forget_terms(session)
    await here.run(here.store.change, session.id, session.key_id, wanted.name, config)
    here.bell.ring(session.id)
    return await read(session, here)


@router.delete(
    "/sessions/{session_id}", status_code=204, summary="Delete a session", operation_id="delete_session"
)
async def delete(session: SessionDep, here: ContextDep) -> None:
    """Delete a session with its measurements, its state and its estimates."""
    await here.run(here.store.delete, session.id, session.key_id)
    here.bell.ring(session.id)


@router.post(
    "/sessions/{session_id}/shares",
    status_code=201,
    summary="Share a session",
    operation_id="share_session",
    responses={201: {"model": Share}},
)
async def share(
    session: SessionDep,
    here: ContextDep,
    hours: Annotated[float, Query(gt=0.0, le=8766.0, description="Until the share expires.")] = 24.0,
) -> dict[str, str]:
    """Make a key to this session alone that only reads and expires; it cannot be shown again.

    The page opens it at `link`, whose part after `#` no server and no log sees.
    """
    await here.run(here.store.session, session.id, session.key_id)
    expires_at = datetime.now(UTC) + timedelta(hours=hours)
    key = await here.run(here.keys.share, session.id, expires_at)
    return {"key": key, "expires_at": _instant(expires_at), "link": f"/#/s/{session.id}/{key}"}


@router.put(
    "/sessions/{session_id}/truth",
    status_code=204,
    summary="Give the truth, for comparison",
    openapi_extra=json_content(Truth),
)
async def put_truth(request: Request, session: SessionDep, here: ContextDep) -> None:
    """Walls, anchors and track that the page draws beside the estimates; no engine sees them."""
    body = await request.body()
    await here.run(here.store.session, session.id, session.key_id)
    truth = await here.parsed(session, body, TruthTask(body))
    await here.run(here.store.set_truth, session.id, session.key_id, truth)


@router.get(
    "/sessions/{session_id}/truth",
    summary="Read the truth",
    response_class=Response,
    responses=_TRUTH,
)
async def get_truth(session: SessionDep, here: ContextDep) -> Response:
    """The truth that was given, null if none was."""
    return Response(await here.run(_truth, here, session) or "null", media_type="application/json")


def _truth(here: Context, session: SessionAccess) -> str | None:
    with here.store.reading() as connection:
        here.store.session(session.id, session.key_id, connection)
        return here.store.truth(session.id, connection)


def session_document(row: Row[Any]) -> dict[str, Any]:
    """A session's row as the service shows it."""
    config = json.loads(row.config)
    return {
        "id": row.id,
        "name": row.name,
        "created_at": _instant(row.created_at),
        "updated_at": _instant(row.updated_at),
        "next_sweep": row.next_sweep,
        "next_epoch": row.next_epoch,
        "time_s": row.time_s,
        "integrity": row.integrity,
        "warnings": _warnings(row, config),
        **config,
    }


def _warnings(row: Row[Any], config: Mapping[str, Any]) -> list[str]:
    """What will keep a session from giving estimates."""
    if row.next_epoch > 0 or row.next_sweep > 0 or config.get("known_anchors_m") is not None:
        return []
    return [
        "no walls sensed and no anchors known: post a sweep before epoch 0, or make the session with "
        "known_anchors_m"
    ]


def _instant(value: datetime) -> str:
    aware = value if value.tzinfo else value.replace(tzinfo=UTC)
    return aware.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
