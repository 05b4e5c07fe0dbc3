"""Who may send what, decided before a body is read, and the body read within limits.

A request's head is enough to refuse it: no key, a page of another origin, a body that is too large or
packed. Only then is the body received, so much at a time and so much of all clients together.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from service.api.auth import Caller
from service.api.context import Context
from service.api.unpacking import ENCODINGS, unpacked_body
from service.errors import (
    AuthenticationError,
    BusyError,
    ForbiddenError,
    SlowBodyError,
    TooLargeError,
    UnsupportedMediaError,
)
from service.settings import Settings

__all__ = ["Admission", "BodyBudget"]

Scope = dict[str, Any]
Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]

_OPEN = frozenset(("/", "/docs", "/openapi.json", "/livez", "/readyz"))
_BINARY = "application/octet-stream"
_JSON = "application/json"
_LARGE_JSON = ("/epochs", "/truth")
_STREAM, _LINES = "/epochs/stream", "application/x-ndjson"
_STREAM_BYTES = 4 * 2**20  # that a stream holds at most: a line, and what waits
_PROTOCOL, _KEY_PROTOCOL = "hapslam", "hapslam.key."  # of WebSockets
_READING = frozenset(("GET", "HEAD", "OPTIONS"))
_WITH_BODY = frozenset(("POST", "PUT", "PATCH", "DELETE"))


class BodyBudget:
    """Bytes of bodies in memory: so many in all, and half of that for a key.

    Parameters
    ----------
    most_bytes : int
        In all.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most, self._total = most_bytes, 0
        self._of_key: defaultdict[str | None, int] = defaultdict(int)

    @contextmanager
    def claim(self, key: str | None) -> Iterator[Callable[[int], None]]:
        """A function that claims so many more bytes, until the end of the context; it raises BusyError."""
        claimed = 0

        def more(count: int) -> None:
            nonlocal claimed
            if self._total + count > self._most or self._of_key[key] + count > self._most // 2:
                raise BusyError("expected a smaller body, many others are being received; come again", 2)
            claimed += count
            self._total += count
            self._of_key[key] += count

        try:
            yield more
        finally:
            self._total -= claimed
            self._of_key[key] -= claimed
            if not self._of_key[key]:
                del self._of_key[key]


class Admission:
    """ASGI middleware; see the head of this module.

    Parameters
    ----------
    app : callable
        The application.
    here : Context
        What the routes share.
    """

    def __init__(self, app: Callable[..., Awaitable[None]], here: Context) -> None:
        self._app, self._here = app, here
        self._budget = BodyBudget(here.settings.max_bodies_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] == "websocket":
            await self._socket(scope, receive, send)
            return
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        caller = Caller(None)
        if scope["path"] not in _OPEN and not scope["path"].startswith("/web/"):
            _check_origin(scope, headers)
            caller = await self._caller(scope, headers)
            if caller.role == "read" and scope["method"] not in _READING:
                raise ForbiddenError("expected a key that may write, got one that only reads")
        scope["state"]["caller"] = caller
        if scope["method"] not in _WITH_BODY:
            await self._app(scope, receive, send)
            return
        if scope["path"].endswith(_STREAM):
            _check_stream(headers)
            with self._budget.claim(caller.key_id) as claim:
                claim(_STREAM_BYTES)
                await self._app(scope, receive, send)
            return
        limit = _body_limit(scope["path"], headers, self._here.settings)
        _check_body(headers, limit)
        with self._budget.claim(caller.key_id) as claim:
            body = await _received(receive, limit, claim, self._here.settings.body_stall_s)
            if (packed := _encoding(headers)) and body:
                body = await unpacked_body(body, packed, limit, claim, self._here.run)
            await self._app(scope, _replayed(body, receive), send)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a WebSocket in; a browser, which sends no header, gives its key as a subprotocol."""
        headers, state = _headers(scope), scope.setdefault("state", {})
        offered = [name.strip() for name in headers.get("sec-websocket-protocol", "").split(",")]
        keys = [name.removeprefix(_KEY_PROTOCOL) for name in offered if name.startswith(_KEY_PROTOCOL)]
        if "authorization" not in headers and keys:
            headers["authorization"] = f"Bearer {keys[0]}"
        state["request_id"] = secrets.token_hex(8)
        try:
            _check_origin(scope, headers)
            state["caller"] = await self._caller(scope, headers)
        except (AuthenticationError, ForbiddenError) as error:
            await receive()
            code = 4401 if isinstance(error, AuthenticationError) else 4403
            await send({"type": "websocket.close", "code": code, "reason": str(error)[:100]})
            return
        state["authorization"] = headers.get("authorization")
        state["subprotocol"] = _PROTOCOL if _PROTOCOL in offered else None
        await self._app(scope, receive, send)

    async def _caller(self, scope: Scope, headers: dict[str, str]) -> Caller:
        client = scope["client"][0] if scope.get("client") else None
        host = urlsplit(f"//{headers.get('host', '')}").hostname
        return await self._here.admit(headers.get("authorization"), client, host)


def _headers(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}


def _check_stream(headers: dict[str, str]) -> None:
    """A stream is of lines, and not packed; raises UnsupportedMediaError."""
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != _LINES or _encoding(headers):
        raise UnsupportedMediaError(
            f"expected a body of the type {_LINES}, not packed, got {kind[:100] or 'one without a type'}"
        )


def _check_origin(scope: Scope, headers: dict[str, str]) -> None:
    """A page of another origin may not act for whoever looks at it; raises ForbiddenError."""
    site, origin = headers.get("sec-fetch-site", "none"), headers.get("origin")
    if site not in ("same-origin", "none"):
        raise ForbiddenError(f"expected a request of this service's own page, got one of a {site} page")
    if origin is not None and urlsplit(origin).netloc.lower() != headers.get("host", "").lower():
        raise ForbiddenError(f"expected a request of this service's own page, got one of {origin[:100]}")


def _encoding(headers: dict[str, str]) -> str:
    """How a body is packed; empty if it is not."""
    return headers.get("content-encoding", "").strip().lower().removeprefix("identity")


def _body_limit(path: str, headers: dict[str, str], settings: Settings) -> int:
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind == _BINARY:
        return settings.max_body_bytes
    if path.endswith(_LARGE_JSON):
        return min(settings.max_json_bytes, settings.max_body_bytes)
    return min(settings.max_small_json_bytes, settings.max_body_bytes)


def _check_body(headers: dict[str, str], limit: int) -> None:
    """Refuse by its head what would not be read: too large, packed, or of a type that no route takes."""
    length = headers.get("content-length", "0")
    if length.isdigit() and int(length[:20]) > limit:
        raise TooLargeError(f"body: expected at most {limit} bytes, got {length}")
    packed = _encoding(headers)
    if packed not in ("", *ENCODINGS):
        raise UnsupportedMediaError(
            f"body: expected no content encoding, or {' or '.join(ENCODINGS)}, got {packed[:64]}"
        )
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    has_body = length != "0" or "transfer-encoding" in headers
    if has_body and kind not in (_BINARY, _JSON) and not kind.endswith("+json"):
        raise UnsupportedMediaError(
            f"expected a body of the type {_JSON} or {_BINARY}, got {kind[:100] or 'one without a type'}"
        )


async def _received(receive: Receive, limit: int, claim: Callable[[int], None], stall_s: float) -> bytes:
    """A body, whole; raises TooLargeError, BusyError or SlowBodyError."""
    pieces, size, more = [], 0, True
    while more:
        try:
            async with asyncio.timeout(stall_s):
                message = await receive()
        except TimeoutError:
            raise SlowBodyError(f"body: expected the next piece within {stall_s:g} s, got none") from None
        if message["type"] == "http.disconnect":
            raise SlowBodyError(f"body: expected all of it, got {size} bytes before the connection ended")
        piece, more = message.get("body", b""), message.get("more_body", False)
        size += len(piece)
        if size > limit:
            raise TooLargeError(f"body: expected at most {limit} bytes, got more")
        claim(len(piece))
        pieces.append(piece)
    return b"".join(pieces)


def _replayed(body: bytes, receive: Receive) -> Receive:
    """What the application receives: the body at once, then what follows."""
    told = False

    async def replay() -> dict[str, Any]:
        nonlocal told
        if told:
            return await receive()
        told = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replay
