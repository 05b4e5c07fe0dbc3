"""Epochs on one connection: lines of a body (NDJSON), or messages of a WebSocket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response, WebSocket, WebSocketDisconnect

from service.api.context import Context, ContextDep, SessionAccess, SessionDep
from service.api.ingest import Ingest, IngestLimits, lines_of
from service.errors import BusyError, NotFoundError, SlowBodyError, TooLargeError

__all__ = ["router"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["measurements"])
NDJSON = "application/x-ndjson"
_LIMITS = IngestLimits()
_BODY = {
    "requestBody": {
        "required": True,
        "description": "An epoch a line, as `epochs` takes it.",
        "content": {NDJSON: {"schema": {"type": "string"}}},
    }
}
WithState = Annotated[bool, Query(description="Whether answers have the state where it was computed.")]


class LinesResponse(Response):
    """Answers line by line while the body of the request still comes."""

    media_type = NDJSON

    def __init__(self, ingest: Ingest, stall_s: float, opened: AbstractContextManager[None]) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._ingest, self._stall_s, self._opened = ingest, stall_s, opened

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Take in the body's lines."""
        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})

        async def answer(line: str) -> None:
            await send({"type": "http.response.body", "body": line.encode() + b"\n", "more_body": True})

        with self._opened:
            await self._ingest.run(lines_of(_pieces(receive, self._stall_s), _LIMITS.line_bytes), answer)
        await send({"type": "http.response.body", "body": b""})


async def _pieces(receive: Any, stall_s: float) -> AsyncIterator[bytes]:
    more = True
    while more:
        try:
            async with asyncio.timeout(stall_s):
                message = await receive()
        except TimeoutError:
            raise SlowBodyError(f"body: expected the next piece within {stall_s:g} s, got none") from None
        if message["type"] == "http.disconnect":
            return
        more = message.get("more_body", False)
        yield message.get("body", b"")


@router.post(
    "/epochs/stream", summary="Stream epochs, one a line", response_class=Response, openapi_extra=_BODY
)
async def lines(
    request: Request, session: SessionDep, here: ContextDep, state: WithState = False
) -> Response:
    """Take in epochs as they come, and answer each with a line when it is on disk.

    An answer is `{"epoch": 7, "new": true}`, or `{"problem": {...}}`, which ends the stream. What was not
    answered is sent again.
    """
    await here.terms(session)
    here.streams.check(session.key_id)
    authorization, request_id = request.headers.get("authorization"), str(request.state.request_id)
    ingest = Ingest(here, session, authorization, request_id, state, _LIMITS)
    return LinesResponse(ingest, here.settings.stream_stall_s, here.streams.opened(session.key_id))


@router.websocket("/socket")
async def socket(websocket: WebSocket, session_id: str, state: bool = False) -> None:
    """The same over a WebSocket: an epoch a message, an answer a message."""
    here: Context = websocket.app.state.context
    who = websocket.state.caller
    session = SessionAccess(session_id, who.key_id)
    if who.session_id not in (None, session_id) or who.role == "read":
        await websocket.close(4403, "expected a key that may write")
        return
    try:
        await here.terms(session)
        here.streams.check(session.key_id)
    except (NotFoundError, BusyError) as error:
        await websocket.close(4404 if isinstance(error, NotFoundError) else 4429, str(error)[:100])
        return
    await websocket.accept(websocket.state.subprotocol)
    ingest = Ingest(here, session, websocket.state.authorization, websocket.state.request_id, state, _LIMITS)
    with here.streams.opened(session.key_id):
        try:
            await ingest.run(_messages(websocket), websocket.send_text)
            await websocket.close(1000)
        except (WebSocketDisconnect, RuntimeError):  # the client has gone
            return


async def _messages(websocket: WebSocket) -> AsyncIterator[bytes]:
    while True:
        message = await websocket.receive()
        if message["type"] != "websocket.receive":
            return
        text = message.get("text")
        body = text.encode() if text is not None else message.get("bytes") or b""
        if len(body) > _LIMITS.line_bytes:
            raise TooLargeError(f"message: expected at most {_LIMITS.line_bytes} bytes, got {len(body)}")
        yield body
