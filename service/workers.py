"""Long-lived processes that step sessions; a session keeps its worker.

So many may wait for a worker and no more: who comes then is told to come again. A worker that
exceeds its time or dies is replaced; what it had in work was not committed, so
nothing is lost. Workers end with the server, even if it was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import select
import signal
import threading
import warnings
import zlib
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Protocol, TypeVar

from service.confinement import limit_memory
from service.errors import BusyError, StepTimeoutError, WorkerDiedError
from service.fold import Folded, Job, StateCache

__all__ = ["StepPool", "Task"]

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


def _serve(connection: Connection, most_bytes: int) -> None:
    """Life of a worker: task after task until the server is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the server drains, then closes the connection
    limit_memory(most_bytes)
    warnings.simplefilter("ignore", RuntimeWarning)  # wild measurements overflow; estimates are checked
    parent = multiprocessing.parent_process()
    threading.Thread(target=_end_with, args=(parent.sentinel if parent else -1,), daemon=True).start()
    cache = StateCache()
    while True:
        try:
            task: Task[Any] = connection.recv()
        except (EOFError, OSError):
            return
        answer: tuple[Any, Exception | None]
        try:
            answer = (task.run(cache), None)
        except Exception as error:  # to be raised where the request waits
            answer = (None, error)
        connection.send(answer)


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


class Task(Protocol[T_co]):
    """Work for a worker: it travels to the process and back by value."""

    def run(self, cache: StateCache) -> T_co:
        """Do it."""
        ...


class StepPool:
    """Folds jobs in processes of their own.

    Parameters
    ----------
    workers : int
        Processes; 0 folds in the calling thread.
    max_waiting : int
        Jobs that may wait for one worker.
    timeout_s : float
        Longest time of one job.
    most_bytes : int
        Memory of a process.
    """

    def __init__(
        self, workers: int, max_waiting: int, timeout_s: float, most_bytes: int = 576 * 2**20
    ) -> None:
        self._workers = [_Worker(max_waiting, timeout_s, most_bytes) for _ in range(workers)]
        self._own = threading.Lock()
        self._cache = StateCache()

    def __enter__(self) -> StepPool:
        for worker in self._workers:
            worker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.stop()

    @property
    def waiting(self) -> int:
        """Jobs that wait or are in work."""
        return sum(worker.waiting for worker in self._workers)

    def fold(self, job: Job) -> Folded:
        """Fold a job with its session's worker; raises as :meth:`run` and :func:`service.fold.fold`."""
        return self.run(job.session_id, job)

    def run(self, key: str, task: Task[T]) -> T:
        """Run a task with the worker that ``key`` belongs to.

        Raises
        ------
        BusyError
            If too many tasks wait for the worker.
        StepTimeoutError
            If the task took too long.
        WorkerDiedError
            If the worker died over it.
        """
        if not self._workers:
            with self._own:
                return task.run(self._cache)
        result: T = self._workers[zlib.crc32(key.encode()) % len(self._workers)].do(task)
        return result


class _Worker:
    """A process that does one task at a time, and those who wait for it."""

    def __init__(self, max_waiting: int, timeout_s: float, most_bytes: int) -> None:
        self._timeout_s, self._max_waiting, self._most_bytes = timeout_s, max_waiting, most_bytes
        self._turn, self._guard = threading.Lock(), threading.Lock()
        self.waiting = 0

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._most_bytes), daemon=True)
        self._process.start()
        theirs.close()
        self._answered = select.poll()
        self._answered.register(self._connection.fileno(), select.POLLIN)

    def stop(self) -> None:
        taken = self._turn.acquire(timeout=self._timeout_s)  # what is in work is finished
        self._process.kill()
        self._process.join()
        self._connection.close()
        if taken:
            self._turn.release()

    def do(self, task: Task[Any]) -> Any:
        with self._guard:
            if self.waiting > self._max_waiting:
                raise BusyError(f"expected a free worker, {self.waiting} requests wait already")
            self.waiting += 1
        try:
            with self._turn:
                return self._ask(task)
        finally:
            with self._guard:
                self.waiting -= 1

    def _ask(self, task: Task[Any]) -> Any:
        try:
            self._connection.send(task)
            if not self._answered.poll(1000.0 * self._timeout_s):
                self._replace()
                raise StepTimeoutError(f"expected the step to take at most {self._timeout_s:g} s, gave it up")
            value, problem = self._connection.recv()
        except (EOFError, OSError) as error:
            self._replace()
            raise WorkerDiedError(
                "the process that stepped the session died; nothing was taken in"
            ) from error
        if problem is not None:
            raise problem
        return value

    def _replace(self) -> None:
        self._process.kill()
        self._process.join()
        self._connection.close()
        self.start()
