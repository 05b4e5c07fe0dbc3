"""Whether the database answers: asked once for all who want to know at the same time."""

from __future__ import annotations

import asyncio
import time

import anyio
import anyio.to_thread
import sqlalchemy as sa
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

__all__ = ["Readiness"]

_FRESH_S = 0.5  # how old an answer may be


class Readiness:
    """What ``/readyz`` tells; it has a thread of its own, and never more than one."""

    def __init__(self) -> None:
        self._answered, self._ready = -_FRESH_S, False
        self._asking: asyncio.Task[None] | None = None
        self._thread: anyio.CapacityLimiter | None = None

    async def ready(self, engine: Engine) -> bool:
        """Whether the database answers, or did so just now."""
        if time.monotonic() - self._answered >= _FRESH_S:
            if self._asking is None or self._asking.done():
                self._asking = asyncio.create_task(self._ask(engine))
            await asyncio.shield(self._asking)
        return self._ready

    async def _ask(self, engine: Engine) -> None:
        self._thread = self._thread or anyio.CapacityLimiter(1)
        self._ready = await anyio.to_thread.run_sync(_answers, engine, limiter=self._thread)
        self._answered = time.monotonic()


def _answers(engine: Engine) -> bool:
    try:
        with engine.connect() as connection:
            connection.execute(sa.select(1))
    except SQLAlchemyError:
        return False
    return True
