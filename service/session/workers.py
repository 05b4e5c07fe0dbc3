"""The worker processes of a server, by what they do.

``steps`` take a few epochs into a session and are quick; ``bulk`` reads files of strangers, parses large
bodies and takes in what is large; ``reads`` makes maps, pictures and files from the database. What may
take long is done in processes that come last on a busy processor, so that a step of another
key waits for none of it.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from enum import StrEnum
from typing import TypeVar

import anyio
import anyio.to_thread

from service.session.tasks import Task, TaskContext, WorkerSetup
from service.session.turns import Key, Quota, TurnRules, Turns
from service.session.worker import LocalWorker, Worker
from service.settings import Settings
from service.storage.store import Store

__all__ = ["AnyWorker", "Lane", "Workers"]

T = TypeVar("T")
AnyWorker = Worker | LocalWorker
_BEHIND = 10  # niceness of what may take long: a tenth of the processor beside a step


class Lane(StrEnum):
    """What workers are for."""

    STEPS = "steps"
    BULK = "bulk"
    READS = "reads"


class Workers:
    """All worker processes, and who waits for them.

    Parameters
    ----------
    settings : Settings
        How many, and their limits; with ``workers = 0`` everything is done in this process.
    store : Store
        The database, for what is done in this process.
    """

    def __init__(self, settings: Settings, store: Store) -> None:
        self._quota = Quota(settings.max_work_s_per_minute)
        self._workers = _made(settings, store)
        rules = TurnRules(settings.max_waiting, settings.max_wait_s)
        self._turns = {lane: Turns(workers, rules) for lane, workers in self._workers.items()}
        self._threads = anyio.CapacityLimiter(sum(len(workers) for workers in self._workers.values()))

    def start(self) -> None:
        """Begin the processes."""
        for worker in self._all():
            worker.start()

    def stop(self) -> None:
        """End the processes, whatever they do."""
        for worker in self._all():
            worker.stop()

    def _all(self) -> list[AnyWorker]:
        return [worker for workers in self._workers.values() for worker in workers]

    @property
    def waiting(self) -> int:
        """Requests that wait for a worker or have one."""
        return sum(turns.waiting for turns in self._turns.values())

    def drain(self) -> None:
        """Send away those who want to read; what is to be taken in has the time of the drain."""
        self._turns[Lane.READS].close()

    async def run(self, lane: Lane, key: Key, session: str, task: Task[T]) -> T:
        """Have a task done in a process.

        Raises
        ------
        BusyError
            If too much is going on, or the key has used up its share.
        DrainingError, StepTooLongError, StepTooLargeError, WorkerDiedError
            See :meth:`service.session.worker.Worker.do`.
        """
        return await self.hold(lane, key, session, lambda worker: worker.do(task))

    async def hold(self, lane: Lane, key: Key, session: str, work: Callable[[AnyWorker], T]) -> T:
        """Run a function in a thread that has a worker to itself; raises as :meth:`run`.

        Who gives up while waiting waits no longer; what is in work is finished.
        """
        self._quota.check(key)
        worker = await self._turns[lane].take(key, session)
        finished = asyncio.ensure_future(self._finish(lane, key, worker, work))
        finished.add_done_callback(_seen)
        return await asyncio.shield(finished)

    async def _finish(self, lane: Lane, key: Key, worker: AnyWorker, work: Callable[[AnyWorker], T]) -> T:
        begin = time.monotonic()
        try:
            return await anyio.to_thread.run_sync(work, worker, limiter=self._threads)
        finally:
            self._quota.charge(key, time.monotonic() - begin)
            self._turns[lane].give_back(worker, key)


def _made(settings: Settings, store: Store) -> dict[Lane, list[AnyWorker]]:
    if settings.workers == 0:
        return {lane: [LocalWorker(TaskContext(store=store))] for lane in Lane}
    limits = (settings.max_worker_bytes, settings.step_timeout_s, settings.work_timeout_s)
    database = settings.url.render_as_string(hide_password=False), settings.lock_timeout_s
    return {
        Lane.STEPS: [Worker(WorkerSetup(*limits)) for _ in range(settings.workers)],
        Lane.BULK: [Worker(WorkerSetup(*limits, _BEHIND, True)) for _ in range(settings.bulk_workers)],
        Lane.READS: [
            Worker(WorkerSetup(*limits, _BEHIND, False, database)) for _ in range(settings.read_workers)
        ],
    }


def _seen(finished: asyncio.Future[T]) -> None:
    """An error of one who has gone is nobody's surprise."""
    if not finished.cancelled():
        finished.exception()
