"""What the routes share: the store, the workers, the caller."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, ParamSpec, TypeVar

import anyio
import anyio.to_thread
from fastapi import Depends, Request
from sqlalchemy import Engine

from service.api.auth import Caller, KeyRing
from service.api.pictures import PictureCache
from service.api.readiness import Readiness
from service.api.streams import Streams
from service.api.telemetry import Metrics
from service.messages.terms import SessionTerms
from service.session.pace import Pace
from service.session.tasks import Task, TaskContext
from service.session.workers import Lane, Workers
from service.settings import Settings
from service.storage.jobs import JobStore
from service.storage.store import Store, unknown_session

__all__ = ["Bell", "CallerDep", "Context", "ContextDep", "SessionAccess", "SessionDep", "caller", "context"]

_REMEMBERED = 1000  # sessions whose terms are kept in mind
_TERMS_S = 1.0  # and how long: another process may have added anchors
_THREADS = 32  # that wait for the database
_DOORS = 8  # that look up keys: whoever else waits, a request is let in or refused
_AT_ONCE_BYTES = 4 * 2**10  # of JSON: some milliseconds, even if everything in it is wrong

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
    store, keys, jobs, workers
        Database, API keys, jobs, worker processes; there once the application has started.
    bell : Bell
        Wakes event streams.
    pictures : PictureCache
        Maps that were drawn.
    readiness : Readiness
        Whether the database answers.
    pace : Pace
        How long sessions' epochs take.
    streams : Streams
        Event streams that are open.
    draining : bool
        Whether the server is about to stop: streams end, ``/readyz`` says no.
    """

    settings: Settings
    metrics: Metrics
    store: Store = field(init=False)
    keys: KeyRing = field(init=False)
    jobs: JobStore = field(init=False)
    workers: Workers = field(init=False)
    bell: Bell = field(default_factory=Bell)
    pictures: PictureCache = field(default_factory=PictureCache)
    readiness: Readiness = field(default_factory=Readiness)
    pace: Pace = field(default_factory=Pace)
    draining: bool = False
    streams: Streams = field(init=False)
    _loop: asyncio.AbstractEventLoop | None = None
    _threads: anyio.CapacityLimiter = field(init=False)
    _doors: anyio.CapacityLimiter = field(init=False)
    _terms: dict[SessionAccess, tuple[SessionTerms, float]] = field(default_factory=dict)
    _walls: dict[str, int] = field(default_factory=dict)

    def open(self, engine: Engine) -> None:
        """Begin with a database."""
        self.store, self.keys = Store(engine), KeyRing(engine)
        self.jobs = JobStore(self.store)
        self.workers = Workers(self.settings, self.store)
        self._loop = asyncio.get_running_loop()
        self.streams = Streams(self.settings.max_streams_per_key)
        self._threads, self._doors = anyio.CapacityLimiter(_THREADS), anyio.CapacityLimiter(_DOORS)

    async def terms(self, session: SessionAccess) -> SessionTerms:
        """What a session's epochs are read by; raises NotFoundError."""
        known, until_s = self._terms.get(session, (None, 0.0))
        if known is None or time.monotonic() > until_s:
            row = await self.run(self.store.session, session.id, session.key_id)
            known = SessionTerms.of(json.loads(row.config))
            self._terms[session] = known, time.monotonic() + _TERMS_S
            _forget(self._terms)
        return known

    def forget_terms(self, session: SessionAccess) -> None:
        """A session's terms have changed."""
        self._terms.pop(session, None)

    async def walls(self, session: SessionAccess) -> int:
        """How many walls a session had when last looked at."""
        known = self._walls.get(session.id)
        if known is None:
            known = await self.run(self.store.walls, session.id)
            self.note_walls(session, known)
        return known

    def note_walls(self, session: SessionAccess, walls: int | None) -> None:
        """Remember how many walls a session has; None forgets it."""
        self._walls.pop(session.id, None)
        if walls is not None:
            self._walls[session.id] = walls
            _forget(self._walls)

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a function that waits for the database, and for nothing longer, in a thread."""
        return await anyio.to_thread.run_sync(partial(function, *args, **kwargs), limiter=self._threads)

    async def work(self, lane: Lane, session: SessionAccess, task: Task[T]) -> T:
        """Have a task done by a worker; see :meth:`service.session.workers.Workers.run`."""
        return await self.workers.run(lane, session.key_id, session.id, task)

    async def parsed(self, session: SessionAccess, body: bytes, task: Task[T]) -> T:
        """Have a body parsed: here if that is done at once, by a worker if not; raises ValidationError."""
        if len(body) <= _AT_ONCE_BYTES:
            return task.run(TaskContext())
        return await self.work(Lane.BULK, session, task)

    async def admit(self, authorization: str | None, client: str | None, host: str | None) -> Caller:
        """Who the caller is; see :meth:`service.api.auth.KeyRing.admit`."""
        if self.keys.none_known():
            return self.keys.admit(authorization, client, host)
        admit = partial(self.keys.admit, authorization, client, host)
        return await anyio.to_thread.run_sync(admit, limiter=self._doors)

    def drain(self) -> None:
        """End the streams, send away those who wait to read, and report not ready; from any thread."""
        self.draining = True
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        self.bell.ring_all()
        self.workers.drain()


def _forget(remembered: dict[Any, Any]) -> None:
    if len(remembered) > _REMEMBERED:
        remembered.pop(next(iter(remembered)), None)


async def context(request: Request) -> Context:
    """The application's context."""
    found: Context = request.app.state.context
    return found


ContextDep = Annotated[Context, Depends(context)]


async def caller(request: Request) -> Caller:
    """Who sent the request, as :class:`service.api.admission.Admission` found out."""
    found: Caller = request.state.caller
    return found


CallerDep = Annotated[Caller, Depends(caller)]


async def _access(session_id: str, who: CallerDep) -> SessionAccess:
    if who.session_id not in (None, session_id):
        raise unknown_session(session_id)
    return SessionAccess(session_id, who.key_id)


SessionDep = Annotated[SessionAccess, Depends(_access)]
