"""Who makes the shards: this process, others on this machine, or a Dask cluster.

All three are a :class:`concurrent.futures.Executor` or none. Processes are spawned
(a forked ray tracer deadlocks), use one thread for Dr.Jit each, and end with the
process that started them, however that ends.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from typing import TypeVar

from estimator.errors import BackendError, ConfigurationError

__all__ = ["Workers", "workers"]

Task = TypeVar("Task")
Made = TypeVar("Made")

_CONNECT_SECONDS = 10.0


@dataclass(frozen=True)
class Workers:
    """Workers that are there.

    Parameters
    ----------
    executor : Executor or None
        Where work is done; None for this process.
    count : int
        How many do it.
    """

    executor: Executor | None = None
    count: int = 1

    def run(self, work: Callable[[Task], Made], tasks: Iterable[Task]) -> Iterator[Made]:
        """Do all tasks and give what they made, in the order in which they finish.

        Two tasks for each worker are under way or wait at a time, so memory does not
        grow with the number of tasks.

        Raises
        ------
        BackendError
            If a worker died.
        """
        if self.executor is None:
            yield from map(work, tasks)
            return
        waiting: set[Future[Made]] = set()
        try:
            for task in tasks:
                waiting.add(self.executor.submit(work, task))
                if len(waiting) >= 2 * self.count:
                    done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in done)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        except BrokenProcessPool as error:
            raise BackendError(
                "workers: expected them to finish their shards, one was killed (out of memory?); "
                "go on with --resume and fewer --jobs"
            ) from error
        finally:
            for future in waiting:
                future.cancel()


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None) -> Iterator[Workers]:
    """Start workers, or connect to them, for as long as the context lasts.

    Parameters
    ----------
    jobs : int
        Processes on this machine; 1 is this process alone.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do everything; they have to have this
        package installed and to share the folder of the dataset.

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
        with _cluster(scheduler) as found:
            yield found
    elif jobs == 1:
        yield Workers()
    else:
        pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_end_with_parent)
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
        yield Workers(client.get_executor(pure=False, retries=2), count)


def _end_with_parent() -> None:
    """End this worker when the process that started it has ended, killed perhaps."""
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_outlive, args=(parent.sentinel,), daemon=True).start()


def _outlive(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)
