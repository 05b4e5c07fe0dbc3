"""Long-lived processes that step sessions, each with its queue; a session keeps its worker.

The queues are bounded: who finds a full one is told to come again. A worker that
exceeds its time or dies is replaced; what it had in work was not committed, so
nothing is lost. Workers end with the server, even if it was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import warnings
import zlib
from concurrent.futures import Future
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Protocol, TypeVar

from service.errors import BusyError, StepTimeoutError, WorkerDiedError
from service.fold import Folded, Job, StateCache

__all__ = ["StepPool", "Task"]

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


def _serve(connection: Connection) -> None:
    """Life of a worker: task after task until the server is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the server drains, then closes the connection
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
    """

    def __init__(self, workers: int, max_waiting: int, timeout_s: float) -> None:
        self._workers = [_Worker(max_waiting, timeout_s) for _ in range(workers)]
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
        worker = self._workers[zlib.crc32(key.encode()) % len(self._workers)]
        result: T = worker.submit(task).result()
        return result


class _Worker:
    """A process, the queue before it, and the thread that feeds it."""

    def __init__(self, max_waiting: int, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._queue: queue.Queue[tuple[Task[Any], Future[Any]] | None] = queue.Queue(max_waiting)
        self._thread = threading.Thread(target=self._feed, daemon=True, name="hapslam-worker")
        self._busy = False

    @property
    def waiting(self) -> int:
        return self._queue.qsize() + self._busy

    def start(self) -> None:
        self._spawn()
        self._thread.start()

    def stop(self) -> None:
        self._queue.put(None)
        self._thread.join(self._timeout_s)
        self._process.kill()
        self._process.join()
        self._connection.close()

    def submit(self, task: Task[Any]) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            self._queue.put_nowait((task, future))
        except queue.Full:
            raise BusyError(f"expected a free worker, {self._queue.qsize()} requests wait already") from None
        return future

    def _spawn(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()

    def _feed(self) -> None:
        while (item := self._queue.get()) is not None:
            task, future = item
            self._busy = True
            try:
                future.set_result(self._ask(task))
            except BaseException as error:
                future.set_exception(error)
            finally:
                self._busy = False

    def _ask(self, task: Task[Any]) -> Any:
        try:
            self._connection.send(task)
            if not self._connection.poll(self._timeout_s):
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
        self._spawn()
