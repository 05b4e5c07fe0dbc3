"""Server-sent events: every epoch's estimates, in order, none missed.

The stream is read from the database, not from memory: an event's id is its epoch, and a
client that comes back with ``Last-Event-ID`` gets what followed, whichever process of the
service it meets. A stream ends with its key, its share or its session.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from fastapi.sse import format_sse_event

from service.api.context import Context, ContextDep, SessionAccess, SessionDep
from service.errors import AuthenticationError, NotFoundError

__all__ = ["router"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["state"])

_PAGE = 100
_POLL_S = 0.5  # other processes' epochs are seen after at most this
_KEEP_ALIVE_POLLS = 30


@router.get(
    "/events",
    summary="Follow the estimates",
    response_class=StreamingResponse,
    responses={200: {"description": "Events named `epoch`", "content": {"text/event-stream": {}}}},
)
async def events(
    request: Request,
    session: SessionDep,
    here: ContextDep,
    first: Annotated[int, Query(ge=0, le=2**31 - 2, description="Epoch to begin at.")] = 0,
    last_event_id: Annotated[str | None, Header(max_length=20, pattern="^[0-9]{1,10}$")] = None,
    follow: Annotated[bool, Query(description="Stay for what is to come.")] = True,
) -> StreamingResponse:
    """A stream of events ``epoch``, each with the state after that epoch; ``deleted`` is the last."""
    begin = first if last_event_id is None else int(last_event_id) + 1
    await here.run(here.store.session, session.id, session.key_id)
    here.streams.check(session.key_id)
    stream = _stream(here, session, begin, follow, request.headers.get("authorization"))
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


async def _stream(
    here: Context, session: SessionAccess, begin: int, follow: bool, authorization: str | None
) -> AsyncIterator[bytes]:
    yield format_sse_event(comment="hapslam", retry=1000)
    silent = 0
    here.metrics.streams.inc()
    try:
        with here.streams.opened(session.key_id), here.bell.listening(session.id) as rung:
            while not here.draining:
                rung.clear()
                try:
                    page = await here.run(_page, here, session, begin, authorization)
                except (NotFoundError, AuthenticationError):
                    yield format_sse_event(data_str="{}", event="deleted")
                    return
                for epoch, document in page:
                    yield format_sse_event(data_str=document, event="epoch", id=str(epoch))
                    begin, silent = epoch + 1, 0
                if len(page) == _PAGE:
                    continue
                if not follow:
                    return
                try:
                    await asyncio.wait_for(rung.wait(), _POLL_S)
                except TimeoutError:
                    silent += 1
                if silent >= _KEEP_ALIVE_POLLS:
                    silent = 0
                    yield format_sse_event(comment="still here")
    finally:
        here.metrics.streams.dec()


def _page(
    here: Context, session: SessionAccess, begin: int, authorization: str | None
) -> list[tuple[int, str]]:
    """The epochs from ``begin`` on, as long as the key is in force and the session there."""
    if not here.keys.still(authorization):
        raise AuthenticationError("expected a key in force, it was revoked")
    with here.store.reading() as connection:
        here.store.session(session.id, session.key_id, connection)
        rows = here.store.estimates(session.id, begin, 2**31 - 1, connection, _PAGE)
        return [(row.epoch, row.document) for row in rows]
