"""Epochs as they come on one connection, a line or a message each: taken in together where several wait.

Every answer is given when its epoch is on disk. What was not answered is sent again on another connection:
epochs are known by their numbers, so nothing is taken in twice, nothing is lost, wherever either side died.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

from estimator.errors import HapslamError
from service.api.context import Context, SessionAccess
from service.api.problems import problem
from service.api.routes.measurements import limits, taken_in
from service.errors import AuthenticationError, BusyError, DrainingError, TooLargeError
from service.session.entries import EpochEntry
from service.session.lines import LinesTask

__all__ = ["Ingest", "IngestLimits", "lines_of"]

Answer = Callable[[str], Awaitable[None]]
_POLL_S = 0.5  # how soon a drain of the server or a revoked key is noticed


@dataclass(frozen=True)
class IngestLimits:
    """How much of a stream is held.

    Parameters
    ----------
    line_bytes : int
        Longest line or message.
    together : int
        Epochs that are taken in together at most.
    together_bytes : int
        Their bytes.
    busy_s : float
        How long a stream waits for its turn where the service is busy, seconds.
    """

    line_bytes: int = 2 * 2**20
    together: int = 64
    together_bytes: int = 2 * 2**20
    busy_s: float = 60.0


class Ingest:
    """One stream of epochs into a session.

    Parameters
    ----------
    here : Context
        What the routes share.
    session : SessionAccess
        The session.
    authorization : str or None
        What the stream was let in by; it ends with the key.
    request_id : str
        For problems.
    with_state : bool
        Whether the last answer of those that were taken in together has the state.
    most : IngestLimits, optional
        How much is held.
    """

    def __init__(
        self,
        here: Context,
        session: SessionAccess,
        authorization: str | None,
        request_id: str,
        with_state: bool,
        most: IngestLimits | None = None,
    ) -> None:
        self._here, self._session, self._authorization = here, session, authorization
        self._request_id, self._with_state = request_id, with_state
        self._most = most or IngestLimits()
        self._checked_s = time.monotonic()

    async def run(self, lines: AsyncIterator[bytes], answer: Answer) -> None:
        """Take in lines until they end, or one cannot be; that one is answered with a problem."""
        queue: asyncio.Queue[bytes | HapslamError | None] = asyncio.Queue(self._most.together)
        reader = asyncio.create_task(_read(lines, queue))
        try:
            while (batch := await self._batch(queue)) is not None:
                await self._take(batch, answer)
        except HapslamError as error:
            await answer(self._refused(error))
        finally:
            reader.cancel()

    async def _batch(self, queue: asyncio.Queue[bytes | HapslamError | None]) -> list[bytes] | None:
        """The lines that wait, at least one; None at the end. Raises what ended the stream."""
        first = await self._next(queue)
        if first is None:
            return None
        batch, size = [first], len(first)
        while not queue.empty() and len(batch) < self._most.together and size < self._most.together_bytes:
            line = queue.get_nowait()
            if not isinstance(line, bytes):
                queue.put_nowait(line)  # the end; there is room, for it was taken just now
                break
            batch.append(line)
            size += len(line)
        return batch

    async def _next(self, queue: asyncio.Queue[bytes | HapslamError | None]) -> bytes | None:
        while True:
            if self._here.draining:
                raise DrainingError("expected a server that runs on, it is about to stop; come again")
            if time.monotonic() - self._checked_s > 2 * _POLL_S:
                await self._check_key()
            try:
                async with asyncio.timeout(_POLL_S):
                    line = await queue.get()
            except TimeoutError:
                continue
            if isinstance(line, HapslamError):
                raise line
            return line

    async def _check_key(self) -> None:
        """Raise AuthenticationError if the key is no longer in force."""
        if not await self._here.run(self._here.keys.still, self._authorization):
            raise AuthenticationError("expected a key in force, it was revoked")
        self._checked_s = time.monotonic()

    async def _take(self, batch: Sequence[bytes], answer: Answer) -> None:
        """Take in lines, all together if they go together, else one by one; raises what stopped it."""
        here, session = self._here, self._session
        task = LinesTask(tuple(batch), await here.terms(session), limits(here))
        entries, wrong = await here.parsed(session, b"".join(batch), task)
        if entries:
            try:
                await self._commit(entries, answer)
            except BusyError:
                raise
            except HapslamError:
                if len(entries) == 1:
                    raise
                for entry in entries:
                    await self._commit([entry], answer)
        if wrong is not None:
            raise wrong

    async def _commit(self, entries: Sequence[EpochEntry], answer: Answer) -> None:
        end = time.monotonic() + self._most.busy_s
        while True:
            try:
                taken, state = await taken_in(self._here, self._session, entries)
                break
            except BusyError as error:  # the stream waits, as a client would that comes again
                if self._here.draining or time.monotonic() + error.retry_after_s > end:
                    raise
                await asyncio.sleep(error.retry_after_s)
        known = len(entries) - taken.new
        for place, entry in enumerate(entries):
            last = self._with_state and place == len(entries) - 1
            rest = f',"state":{state}' if last else ""
            await answer(f'{{"epoch":{entry.number},"new":{json.dumps(place >= known)}{rest}}}')

    def _refused(self, error: HapslamError) -> str:
        document: Any = json.loads(bytes(problem(error, self._request_id).body))
        return json.dumps({"problem": document}, separators=(",", ":"))


async def _read(lines: AsyncIterator[bytes], queue: asyncio.Queue[bytes | HapslamError | None]) -> None:
    try:
        async for line in lines:
            await queue.put(line)
    except HapslamError as error:
        await queue.put(error)
        return
    await queue.put(None)


async def lines_of(pieces: AsyncIterator[bytes], most_bytes: int) -> AsyncIterator[bytes]:
    """Lines of a body that comes in pieces; empty ones are passed over.

    A last line that its end is missing of counts if it is whole JSON: the client ended the body there.

    Raises
    ------
    TooLargeError
        If a line is longer than ``most_bytes``.
    """
    rest = b""
    async for piece in pieces:
        *whole, rest = (rest + piece).split(b"\n")
        if max(map(len, (*whole, rest))) > most_bytes:
            raise TooLargeError(f"line: expected at most {most_bytes} bytes, got more")
        for line in whole:
            if line.strip():
                yield line
    if rest.strip():
        yield rest
