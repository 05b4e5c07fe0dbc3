"""What runs in a worker process: it warms up, limits itself, and does one task after the other."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import warnings
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

from service.session.confinement import confine, limit_memory
from service.session.tasks import Task, TaskContext, WorkerSetup

if TYPE_CHECKING:
    from service.storage.store import Store

__all__ = ["serve"]


def serve(connection: Connection, setup: WorkerSetup, first: bool) -> None:
    """Life of a process: task after task until the server is gone.

    Parameters
    ----------
    connection : Connection
        Where tasks come from and answers go to, as pairs of a kind and a content: ``ready`` once, or
        ``compiled`` instead; ``step`` before each step, ``done`` or ``failed`` after each task.
    setup : WorkerSetup
        What it is like.
    first : bool
        Whether it ends where it had to compile the engine, so that another begins with the memory of one
        that loads it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the server drains, then ends its processes
    parent = multiprocessing.parent_process()
    threading.Thread(target=_end_with, args=(parent.sentinel if parent else -1,), daemon=True).start()
    os.nice(setup.nice)
    warnings.simplefilter("ignore", RuntimeWarning)  # wild measurements overflow; estimates are checked
    context = TaskContext(begin_step=lambda what: connection.send(("step", what)))
    if setup.database is not None:
        context.store = _opened(*setup.database)
    _warm_up(setup)
    if first and _compiled():
        if setup.reads_files:
            _compile_the_rest()
        connection.send(("compiled", None))  # and what that took stays in memory: the next process loads it
        return
    limit_memory(setup.most_bytes)
    connection.send(("ready", None))
    while True:
        try:
            task: Task[Any] = connection.recv()
        except (EOFError, OSError):
            return
        try:
            connection.send(("done", task.run(context)))
        except Exception as error:  # to be raised where the request waits
            _tell(connection, error)


def _warm_up(setup: WorkerSetup) -> None:
    from service.session import warmup  # of the processes alone: the server starts sooner

    if setup.database is not None:
        warmup.warm_up_smoothing()
        return
    warmup.warm_up_steps()
    if setup.reads_files:
        warmup.warm_up_reading()
        confine()


def _compiled() -> bool:
    """Whether this process had to compile, and has kept for others what it compiled."""
    from estimator.compiled import cache_folder, compiled_here

    return compiled_here() and cache_folder() is not None


def _compile_the_rest() -> None:
    from service.session.warmup import warm_up_methods

    warm_up_methods()


def _tell(connection: Connection, error: Exception) -> None:
    """Send an error without what led to it: the server would rebuild all of that while nobody else runs."""
    error.__cause__ = error.__context__ = error.__traceback__ = None
    try:
        connection.send(("failed", error))
    except Exception:  # it does not travel
        connection.send(("failed", RuntimeError(f"{type(error).__name__}: {error}"[:2000])))


def _opened(url: str, lock_timeout_s: float) -> Store:
    from sqlalchemy import make_url

    from service.storage.database import open_engine
    from service.storage.store import Store

    return Store(open_engine(make_url(url), lock_timeout_s))


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
