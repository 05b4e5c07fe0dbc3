"""Around every request: an id, a limit of time, the log line, the metrics, plain headers."""

from __future__ import annotations

import asyncio
import re
import secrets
import time
from collections.abc import Awaitable, Callable
from typing import Any

import structlog

from service.api.problems import problem
from service.api.telemetry import Metrics
from service.errors import DrainingError

__all__ = ["RequestMiddleware"]

Scope = dict[str, Any]
Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]

_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
_HEADERS = [
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"DENY"),
    (
        b"content-security-policy",
        b"default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'",
    ),
]


class RequestMiddleware:
    """ASGI middleware; see the head of this module.

    Parameters
    ----------
    app : callable
        The application.
    metrics : Metrics
        Where to count.
    timeout_s : float
        Longest time until an answer begins; streams may then go on.
    """

    def __init__(self, app: Callable[..., Awaitable[None]], metrics: Metrics, timeout_s: float) -> None:
        self._app, self._metrics, self._timeout_s = app, metrics, timeout_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = dict(scope["headers"]).get(b"x-request-id", b"")
        request_id = given.decode() if _ID.fullmatch(given) else secrets.token_hex(8)
        scope.setdefault("state", {})["request_id"] = request_id
        begin, status = time.perf_counter(), 0
        limit = asyncio.timeout(self._timeout_s)
        within = True

        async def send_with_headers(message: dict[str, Any]) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                if within:
                    limit.reschedule(None)
                message["headers"] = [
                    *message.get("headers", ()),
                    *_HEADERS,
                    (b"x-request-id", request_id.encode()),
                ]
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            try:
                async with limit:
                    await self._app(scope, receive, send_with_headers)
            except TimeoutError:
                within = False
                if status:
                    raise
                late = TimeoutError(
                    f"expected an answer within {self._timeout_s:g} s; what is in work may yet be taken in"
                )
                await problem(late, request_id)(scope, receive, send_with_headers)  # type: ignore[arg-type]
            except asyncio.CancelledError:  # the server stops, and its patience has ended
                within = False
                if not status:
                    ended = DrainingError("expected a server that runs on, it is about to stop; come again")
                    await problem(ended, request_id)(scope, receive, send_with_headers)  # type: ignore[arg-type]
                raise
            except Exception as error:
                within = False
                if status:
                    raise
                await problem(error, request_id)(scope, receive, send_with_headers)  # type: ignore[arg-type]
            finally:
                self._tell(scope, status, time.perf_counter() - begin)

    def _tell(self, scope: Scope, status: int, seconds: float) -> None:
        route = getattr(scope.get("route"), "path", "other")
        self._metrics.requests.labels(scope["method"], route, str(status)).inc()
        self._metrics.seconds.labels(route).observe(seconds)
        if route in ("/livez", "/readyz", "/metrics"):
            return
        structlog.get_logger().info(
            "request",
            method=scope["method"],
            path=scope["path"],
            status=status,
            ms=round(1e3 * seconds, 1),
        )
