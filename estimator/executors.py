"""Many tasks in this process, in processes of this machine, or on a Dask cluster.

What is run gets everything by value, its seed included, so that results are the same bits wherever
and in however many processes it runs. Processes are spawned (a forked ray tracer deadlocks), have one
thread each for linear algebra, and end with the process that started them, however that ends.

This module imports no NumPy: a worker process imports it first, and limits the threads of what it
loads afterwards.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from estimator.errors import BackendError, ConfigurationError, WorkerLostError

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

__all__ = ["Progress", "Workers", "available_cores", "begin_worker", "open_workers"]

Task = TypeVar("Task")
Made = TypeVar("Made")
Progress = Callable[[int, int], None]

_CONNECT_SECONDS = 10.0
_RETRIES = 2  # of a task whose cluster worker was lost
_CHUNKS_PER_WORKER = 8  # few enough to amortise their transport, enough to end at about the same time
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Workers:
    """Where tasks are done.

    Parameters
    ----------
    executor : Executor or None
        Who does them; None for this process.
    count : int
        How many tasks are done at a time.
    """

    executor: Executor | None = None
    count: int = 1

    def unordered(self, function: Callable[[Task], Made], tasks: Iterable[Task]) -> Iterator[Made]:
        """Results of a function of each task, in the order in which they are finished.

        Two tasks for each worker are in work or wait at a time, so memory does not
        grow with the number of tasks. With the first error the others are cancelled.

        Parameters
        ----------
        function : callable
            Of one task; both can be pickled.
        tasks : iterable
            What is to be done.

        Raises
        ------
        WorkerLostError
            If a worker process was killed.
        """
        if self.executor is None:
            yield from map(function, tasks)
            return
        from concurrent.futures import FIRST_COMPLETED, wait
        from concurrent.futures.process import BrokenProcessPool

        waiting: set[Future[Made]] = set()
        try:
            for task in tasks:
                waiting.add(self.executor.submit(function, task))
                if len(waiting) >= 2 * self.count:
                    done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in done)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        except BrokenProcessPool as error:
            raise WorkerLostError(
                "jobs: expected worker processes to finish, one was killed (out of memory?); try fewer --jobs"
            ) from error
        finally:
            for future in waiting:
                future.cancel()

    def map(
        self, function: Callable[[Task], Made], tasks: Sequence[Task], progress: Progress | None = None
    ) -> list[Made]:
        """Results of a function of each task, in the order of the tasks.

        Tasks travel in chunks, so that what they share is sent once a chunk. A chunk that is
        the only one is done in this process.

        Parameters
        ----------
        function : callable
            Of one task; both can be pickled.
        tasks : sequence
            What is to be done.
        progress : callable, optional
            Called with (tasks done, tasks in all) after each chunk.

        Raises
        ------
        WorkerLostError
            If a worker process was killed.
        """
        size = 1 if self.executor is None else -(-len(tasks) // (_CHUNKS_PER_WORKER * self.count))
        chunks = [_Chunk(function, i, tasks[i : i + size]) for i in range(0, len(tasks), max(size, 1))]
        crew = Workers() if len(chunks) == 1 else self
        results: dict[int, list[Made]] = {}
        done = 0
        for first, made in crew.unordered(_do, chunks):
            results[first] = made
            done += len(made)
            if progress is not None:
                progress(done, len(tasks))
        return [one for first in sorted(results) for one in results[first]]


@dataclass(frozen=True)
class _Chunk:
    """Tasks in a row, from index ``first`` on, and what is done with each."""

    function: Callable[[Any], Any]
    first: int
    tasks: Sequence[Any]


def _do(chunk: _Chunk) -> tuple[int, list[Any]]:
    return chunk.first, [chunk.function(task) for task in chunk.tasks]


@contextmanager
def open_workers(jobs: int = 1, scheduler: str | None = None) -> Iterator[Workers]:
    """Start worker processes, or connect to a cluster, for as long as the context lasts.

    Parameters
    ----------
    jobs : int
        Processes on this machine; 1 is this process alone.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do everything; they have to have this
        package installed, and to share the folders that tasks name.

    Raises
    ------
    ConfigurationError
        If ``jobs`` is below 1, both are asked for, or Dask is not installed.
    BackendError
        If the scheduler does not answer or has no workers.
    """
    if jobs < 1:
        raise ConfigurationError(f"jobs: expected at least 1, got {jobs}")
    if scheduler is not None:
        if jobs != 1:
            raise ConfigurationError(f"jobs: expected none beside a scheduler, got {jobs}")
        with _cluster(scheduler) as crew:
            yield crew
    elif jobs == 1:
        yield Workers()
    else:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=begin_worker)
        try:
            yield Workers(pool, jobs)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _cluster(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigurationError(
            "scheduler: expected Dask to be installed, it is not; pip install 'hapslam[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BackendError(
            f"scheduler: expected a Dask scheduler at {address}, cannot reach it: {error}"
        ) from error
    with client:
        count = len(client.scheduler_info(n_workers=-1)["workers"])
        if count == 0:
            raise BackendError(f"scheduler: expected workers at {address}, there are none")
        yield Workers(client.get_executor(pure=False, retries=_RETRIES), count)


def available_cores() -> int:
    """Processor cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def begin_worker() -> None:
    """Begin the life of a spawned process: one thread for linear algebra, and an end with its parent.

    To be called before NumPy is imported, for BLAS libraries read the number of their threads once.
    """
    from multiprocessing import parent_process

    for name in _THREADS:
        os.environ.setdefault(name, "1")
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """Wait until the parent has ended, killed perhaps, and end this process."""
    from multiprocessing.connection import wait

    wait([sentinel])
    os._exit(1)
