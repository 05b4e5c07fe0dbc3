"""Many runs through an executor of :mod:`concurrent.futures`, results in the order of the runs.

The executor is this process (one job), local processes, or a Dask cluster. What is run gets
everything by value, its seed included, so that results are the same bits in all of them.

This module imports no NumPy: worker processes import it first, and then have one BLAS thread each.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import Any, TypeVar

from estimator.errors import BackendError, ConfigurationError

__all__ = ["Progress", "SerialExecutor", "map_runs", "open_executor"]

T = TypeVar("T")
Task = TypeVar("Task")
Progress = Callable[[int, int], None]

_CONNECT_SECONDS = 10.0
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class SerialExecutor(Executor):
    """Runs each task where it is submitted."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Run ``fn``; the future is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def open_executor(jobs: int = 1, scheduler: str | None = None) -> Iterator[Executor]:
    """An executor, closed at the end; what is still waiting is cancelled if something fails.

    Parameters
    ----------
    jobs : int
        Local processes; 1 runs in this process.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do everything.

    Raises
    ------
    ConfigurationError
        If ``jobs`` is below 1, both are asked for, or Dask is not installed.
    BackendError
        If the scheduler cannot be reached.
    """
    if jobs < 1:
        raise ConfigurationError(f"jobs: expected at least 1, got {jobs}")
    if scheduler is not None:
        if jobs != 1:
            raise ConfigurationError(f"jobs: expected none beside a scheduler, got {jobs}")
        with _cluster(scheduler) as executor:
            yield executor
    elif jobs == 1:
        yield SerialExecutor()
    else:
        pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin_worker)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
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
        yield client.get_executor(pure=False)


def _begin_worker() -> None:
    """One thread for each library, none of which is loaded yet; an end when the parent ends."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_outlive, args=(parent.sentinel,), daemon=True).start()


def _outlive(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def map_runs(
    function: Callable[[Task], T],
    tasks: Iterable[Task],
    executor: Executor,
    progress: Progress | None = None,
) -> list[T]:
    """Results of ``function`` of each task, in the order of the tasks.

    Parameters
    ----------
    function : callable
        Of one task; both can be pickled.
    tasks : iterable
        What is to be done.
    executor : Executor
        See :func:`open_executor`.
    progress : callable, optional
        Called with (tasks done, tasks in all), from any thread, one call at a time.

    Raises
    ------
    BackendError
        If a process was killed.
    """
    work = list(tasks)
    lock, done = threading.Lock(), 0

    def advance(_: Future[T]) -> None:
        nonlocal done
        with lock:
            done += 1
            if progress is not None:
                progress(done, len(work))

    futures: list[Future[T]] = []
    try:
        for task in work:
            future = executor.submit(function, task)
            future.add_done_callback(advance)
            futures.append(future)
            if future.done():
                future.result()  # a serial run fails at once
        return [future.result() for future in futures]
    except BrokenProcessPool as error:
        raise BackendError("jobs: expected processes to finish, one was killed (out of memory?)") from error
    finally:
        for future in futures:
            future.cancel()
