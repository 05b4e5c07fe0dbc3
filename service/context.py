"""What the routes share: the store, the workers, the caller."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, ParamSpec, TypeVar

import anyio.to_thread
from fastapi import Depends, Request

from service.auth import Caller, KeyRing
from service.settings import Settings
from service.store import Store
from service.telemetry import Metrics
from service.workers import StepPool

__all__ = ["Bell", "CallerDep", "Context", "ContextDep", "SessionAccess", "SessionDep", "caller", "context"]

_REMEMBERED = 1000  # sessions whose anchors are kept in mind

P = ParamSpec("P")
T = TypeVar("T")


class Bell:
    """Wakes the event streams of a session when it got measurements in this process."""

    def __init__(self) -> None:
        self._waiting: dict[str, set[asyncio.Event]] = {}

    def ring(self, session_id: str) -> None:
        """Wake those who wait for a session."""
        for event in self._waiting.get(session_id, ()):
            event.set()

    def ring_all(self) -> None:
        """Wake everyone."""
        for session_id in list(self._waiting):
            self.ring(session_id)

    @contextmanager
    def listening(self, session_id: str) -> Iterator[asyncio.Event]:
        """An event that is set at each ring."""
        event = asyncio.Event()
        self._waiting.setdefault(session_id, set()).add(event)
        try:
            yield event
        finally:
            events = self._waiting[session_id]
            events.discard(event)
            if not events:
                del self._waiting[session_id]


@dataclass(frozen=True)
class SessionAccess:
    """A session that a request names, and the key it must belong to."""

    id: str
    key_id: str | None


@dataclass
class Context:
    """One running application.

    Parameters
    ----------
    settings : Settings
        The operator's choices.
    metrics : Metrics
        Counters.
    store, keys, pool
        Database, API keys, workers; there once the application has started.
    bell : Bell
        Wakes event streams.
    draining : bool
        Whether the server is about to stop: streams end, ``/readyz`` says no.
    """

    settings: Settings
    metrics: Metrics
    store: Store = field(init=False)
    keys: KeyRing = field(init=False)
    pool: StepPool = field(init=False)
    threads: anyio.CapacityLimiter = field(init=False)
    bell: Bell = field(default_factory=Bell)
    draining: bool = False
    _anchors: dict[SessionAccess, list[str]] = field(default_factory=dict)

    def anchors(self, session: SessionAccess) -> list[str]:
        """A session's anchors, which never change; raises NotFoundError."""
        known = self._anchors.get(session)
        if known is None:
            row = self.store.session(session.id, session.key_id)
            known = self._anchors[session] = json.loads(row.config)["anchors"]
            if len(self._anchors) > _REMEMBERED:
                self._anchors.pop(next(iter(self._anchors)), None)
        return known

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a blocking function in a thread."""
        return await anyio.to_thread.run_sync(partial(function, *args, **kwargs), limiter=self.threads)

    def drain(self) -> None:
        """End the streams and report not ready."""
        self.draining = True
        self.bell.ring_all()


async def context(request: Request) -> Context:
    """The application's context."""
    found: Context = request.app.state.context
    return found


ContextDep = Annotated[Context, Depends(context)]


async def caller(request: Request, here: ContextDep) -> Caller:
    """Who sent the request; see :meth:`service.auth.KeyRing.admit`."""
    client = request.client.host if request.client else None
    authorization = request.headers.get("authorization")
    if here.keys.none_known():
        return here.keys.admit(authorization, client, request.url.hostname)
    return await here.run(here.keys.admit, authorization, client, request.url.hostname)


CallerDep = Annotated[Caller, Depends(caller)]


async def _access(session_id: str, who: CallerDep) -> SessionAccess:
    return SessionAccess(session_id, who.key_id)


SessionDep = Annotated[SessionAccess, Depends(_access)]
