"""Who gets a worker next: keys take turns, none holds the last worker while others are about.

Everything here happens on the event loop; those who wait are coroutines, not threads, so that however
many wait, nothing else has to.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from service.errors import BusyError, DrainingError

__all__ = ["Key", "Quota", "TurnRules", "Turns"]

W = TypeVar("W")
Key = str | None
_MINUTE_S = 60.0
_ABOUT_S = 30.0  # how long after its last request a key still counts as being about
_REMEMBERED = 4096  # sessions whose last worker is known


@dataclass(frozen=True)
class TurnRules:
    """What one key may ask of a set of workers.

    Parameters
    ----------
    max_waiting : int
        Requests of a key that may wait; more are told to come again.
    longest_wait_s : float
        How long a request waits before it is told to come again, seconds.
    longest_overtaken_s : float
        How long a request lets others of its key pass whose worker is free, seconds: a session's state
        is in the memory of the worker that it had before, and reading it anew costs as much as a step.
    """

    max_waiting: int
    longest_wait_s: float
    longest_overtaken_s: float = 1.0


class Quota:
    """Running seconds of each key: so many a minute, saved up for a minute.

    Parameters
    ----------
    seconds_per_minute : float
        Of all workers together. The caller without a key, who is on this machine, has no quota.
    now : callable
        The clock.
    """

    def __init__(self, seconds_per_minute: float, now: Callable[[], float] = time.monotonic) -> None:
        self._most, self._now = seconds_per_minute, now
        self._used: dict[str, tuple[float, float]] = {}

    def _level(self, key: str) -> float:
        used, at = self._used.get(key, (0.0, 0.0))
        return max(0.0, used - (self._now() - at) * self._most / _MINUTE_S)

    def charge(self, key: Key, seconds: float) -> None:
        """Note what a key has used."""
        if key is not None:
            self._used[key] = self._level(key) + seconds, self._now()

    def check(self, key: Key) -> None:
        """Raise BusyError, with the seconds to wait, if a key has used up what it has."""
        if key is None or (over := self._level(key) - self._most) <= 0.0:
            return
        wait_s = math.ceil(over * _MINUTE_S / self._most)
        raise BusyError(
            f"expected at most {self._most:g} s of work a minute for a key, this one has used more; "
            f"come again in {wait_s} s",
            wait_s,
        )


@dataclass
class _Waiter(Generic[W]):
    session: str
    granted: asyncio.Future[W]
    since: float


@dataclass
class _Standing(Generic[W]):
    """What a key has going on."""

    waiting: deque[_Waiter[W]] = field(default_factory=deque)
    running: int = 0
    seen: float = 0.0


class Turns(Generic[W]):
    """Workers, given to keys in turn.

    Parameters
    ----------
    workers : sequence
        Those to be given; one that a session had before is preferred for it.
    rules : TurnRules
        What one key may ask.
    """

    def __init__(self, workers: Sequence[W], rules: TurnRules) -> None:
        self._free, self._count, self._rules = list(workers), len(workers), rules
        self._keys: OrderedDict[Key, _Standing[W]] = OrderedDict()  # the next to be served comes first
        self._last: OrderedDict[str, W] = OrderedDict()
        self._closed = False

    @property
    def waiting(self) -> int:
        """Requests that wait or are in work."""
        return sum(len(standing.waiting) + standing.running for standing in self._keys.values())

    def close(self) -> None:
        """Send away those who wait, and all who come: the server is about to stop."""
        self._closed = True
        for standing in self._keys.values():
            for waiter in standing.waiting:
                if not waiter.granted.done():
                    waiter.granted.set_exception(_draining())
            standing.waiting.clear()

    async def take(self, key: Key, session: str) -> W:
        """Wait for a worker.

        Raises
        ------
        BusyError
            If too many requests of the key wait, or none became free in time.
        DrainingError
            If the server is about to stop.
        """
        if self._closed:
            raise _draining()
        standing = self._keys.get(key)
        if standing is None:
            standing = self._keys[key] = _Standing()
            self._keys.move_to_end(key, last=False)
        standing.seen = time.monotonic()
        if len(standing.waiting) >= self._rules.max_waiting:
            raise BusyError(
                f"expected a free worker, {len(standing.waiting)} requests of this key wait already"
            )
        waiter: _Waiter[W] = _Waiter(session, asyncio.get_running_loop().create_future(), standing.seen)
        standing.waiting.append(waiter)
        self._grant()
        try:
            async with asyncio.timeout(self._rules.longest_wait_s):
                return await waiter.granted
        except TimeoutError:
            self._withdraw(key, waiter)
            raise BusyError(
                f"expected a free worker within {self._rules.longest_wait_s:g} s, all are busy", 5
            ) from None
        except BaseException:
            self._withdraw(key, waiter)
            raise

    def give_back(self, worker: W, key: Key) -> None:
        """Return a worker."""
        standing = self._keys[key]
        standing.running -= 1
        standing.seen = time.monotonic()
        self._free.append(worker)
        self._grant()

    def _withdraw(self, key: Key, waiter: _Waiter[W]) -> None:
        """One who waited no longer does; what was granted at the same moment is returned."""
        if waiter.granted.done() and not waiter.granted.cancelled() and waiter.granted.exception() is None:
            self.give_back(waiter.granted.result(), key)
        elif waiter in self._keys[key].waiting:
            self._keys[key].waiting.remove(waiter)

    def _grant(self) -> None:
        """Give free workers to the keys whose turn it is."""
        self._forget()
        while self._free:
            key = next((key for key in self._keys if self._may(key)), None)
            if key not in self._keys or not self._may(key):
                return
            standing = self._keys[key]
            waiter = self._next(standing.waiting)
            standing.waiting.remove(waiter)
            if waiter.granted.done():  # withdrawn
                continue
            standing.running += 1
            self._keys.move_to_end(key)
            waiter.granted.set_result(self._choose(waiter.session))

    def _may(self, key: Key) -> bool:
        """Whether a key may have a worker: not the last one that is free while others are about."""
        standing = self._keys[key]
        if not standing.waiting:
            return False
        alone = len(self._keys) == 1
        return alone or standing.running < max(1, self._count - 1)

    def _next(self, waiting: deque[_Waiter[W]]) -> _Waiter[W]:
        """The first that finds its state in a free worker, or may take any; the first, if there is none."""
        first = waiting[0]
        if time.monotonic() - first.since > self._rules.longest_overtaken_s:
            return first
        return next((waiter for waiter in waiting if self._at_home(waiter.session)), first)

    def _at_home(self, session: str) -> bool:
        last = self._last.get(session)
        return last is None or last in self._free

    def _choose(self, session: str) -> W:
        """A free worker: the one that had the session before, or the one that has been idle longest."""
        last = self._last.pop(session, None)
        worker = last if last is not None and last in self._free else self._free[0]
        self._free.remove(worker)
        self._last[session] = worker
        if len(self._last) > _REMEMBERED:
            self._last.popitem(last=False)
        return worker

    def _forget(self) -> None:
        """Keys that have nothing going on and have not been heard of for a while."""
        long_ago = time.monotonic() - _ABOUT_S
        for key, standing in list(self._keys.items()):
            if not standing.waiting and not standing.running and standing.seen < long_ago:
                del self._keys[key]


def _draining() -> DrainingError:
    return DrainingError("expected a server that runs on, it is about to stop; come again")
