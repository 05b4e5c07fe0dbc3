"""A process that does one task at a time, within limits of memory and time.

What exceeds a limit, or crashes, takes its process along and no more: the process is replaced, and the
one who sent the task is told. Processes end with the server, even if it was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import select
import signal
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from service.confinement import confine, limit_memory
from service.errors import BusyError, DrainingError, StepTooLargeError, StepTooLongError, WorkerDiedError
from service.fold import Folded, Job, StateCache

if TYPE_CHECKING:
    from service.store import Store

__all__ = ["LocalWorker", "Task", "TaskContext", "Worker", "WorkerSetup"]

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
_START_S = 300.0  # until a process is ready: on a new machine it compiles the engine first
_START_WAIT_S = 30.0  # that a request waits for it
_PATIENCE = 4.0  # of the wall clock beside processor time: a niced process may wait for its turn
_TICKS_PER_S = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


@dataclass(frozen=True)
class WorkerSetup:
    """What a process is like.

    Parameters
    ----------
    most_bytes : int
        Memory it may take.
    step_limit_s : float
        Processor time of one step of a session, seconds.
    task_limit_s : float
        Time of a whole task, seconds.
    nice : int
        By how much others come first on a busy processor.
    reads_files : bool
        Whether it reads files of strangers.
    database : tuple, optional
        URL and lock timeout of the database that it reads; without it there is none.
    """

    most_bytes: int
    step_limit_s: float
    task_limit_s: float
    nice: int = 0
    reads_files: bool = False
    database: tuple[str, float] | None = None


@dataclass
class TaskContext:
    """What a task finds in its process.

    Parameters
    ----------
    cache : StateCache
        States of sessions stepped before.
    begin_step : callable
        To be called with what is about to be done, before each step whose time is limited.
    store : Store, optional
        The database, in processes that may read it.
    """

    cache: StateCache = field(default_factory=StateCache)
    begin_step: Callable[[str], None] = lambda what: None
    store: Store | None = None

    @property
    def database(self) -> Store:
        """The database of a task that reads it."""
        assert self.store is not None, "expected a process with a database"
        return self.store


class Task(Protocol[T_co]):
    """Work for a process: it travels there and back by value."""

    def run(self, context: TaskContext) -> T_co:
        """Do it."""
        ...


def _serve(connection: Connection, setup: WorkerSetup) -> None:
    """Life of a process: task after task until the server is gone."""
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
    from service import warmup  # of the processes alone: the server starts sooner

    if setup.database is not None:
        warmup.warm_up_smoothing()
        return
    warmup.warm_up_steps()
    if setup.reads_files:
        warmup.warm_up_reading()
        confine()


def _tell(connection: Connection, error: Exception) -> None:
    try:
        connection.send(("failed", error))
    except Exception:  # it does not travel
        connection.send(("failed", RuntimeError(f"{type(error).__name__}: {error}"[:2000])))


def _opened(url: str, lock_timeout_s: float) -> Store:
    from sqlalchemy import make_url

    from service.database import open_engine
    from service.store import Store

    return Store(open_engine(make_url(url), lock_timeout_s))


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


class Worker:
    """A process, as the server sees it; one thread at a time may give it a task.

    Parameters
    ----------
    setup : WorkerSetup
        What it is like.
    """

    def __init__(self, setup: WorkerSetup) -> None:
        self._setup, self._stopped, self._ready = setup, False, False

    def start(self) -> None:
        """Begin a process; it is waited for with the first task."""
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._setup), daemon=True)
        self._process.start()
        self._begun = time.monotonic()
        theirs.close()
        self._answered, self._ready = select.poll(), False
        self._answered.register(self._connection.fileno(), select.POLLIN)

    def stop(self) -> None:
        """End the process; a task in work ends with WorkerDiedError or DrainingError."""
        self._stopped = True
        self._process.kill()
        self._process.join()

    def fold(self, job: Job) -> Folded:
        """Fold a job; raises as :meth:`do` and :func:`service.fold.fold`."""
        return self.do(job)

    def do(self, task: Task[T]) -> T:
        """Have a task done.

        Raises
        ------
        StepTooLongError, StepTooLargeError
            If it took more time or memory than it may.
        BusyError
            If the process is still starting.
        WorkerDiedError
            If the process died over it.
        DrainingError
            If the server stopped meanwhile.
        """
        try:
            if not self._ready:
                self._await_start()
            self._connection.send(task)
            result: T = self._answer()
            return result
        except (EOFError, OSError) as error:
            self._replace()
            raise WorkerDiedError("the process that did the work died; nothing was taken in") from error

    def _answer(self) -> Any:
        setup = self._setup
        end, step, asked = time.monotonic() + setup.task_limit_s, "", self._processor_s()
        while True:
            left = end - time.monotonic()
            allowed = min(left, _PATIENCE * setup.step_limit_s) if step else left
            kind, content = self._message(step, asked, allowed)
            if kind == "step":
                step, asked = content, self._processor_s()
            elif kind == "done":
                return content
            elif kind == "late":
                self._replace()
                raise StepTooLongError(self._too_long(step, end))
            elif isinstance(content, MemoryError):
                self._replace()  # nobody knows what was half done
                raise StepTooLargeError(
                    f"{step or 'the request'}: expected work in {setup.most_bytes >> 20} MiB of memory, "
                    "it needs more; send fewer anchors, paths or walls"
                ) from content
            else:
                raise content

    def _message(self, step: str, asked: float, allowed: float) -> tuple[str, Any]:
        """What the process says next, or that it took too long."""
        end = time.monotonic() + allowed
        while (left := end - time.monotonic()) > 0.0:
            if self._answered.poll(1000.0 * min(left, 0.25 if step else left)):
                message: tuple[str, Any] = self._connection.recv()
                return message
            if step and self._processor_s() - asked > self._setup.step_limit_s:
                break
        return "late", None

    def _too_long(self, step: str, end: float) -> str:
        if step and time.monotonic() < end:
            return (
                f"{step}: expected a step of at most {self._setup.step_limit_s:g} s, gave it up; "
                "nothing was taken in; send fewer paths, anchors or walls"
            )
        return (
            f"expected work of at most {self._setup.task_limit_s:g} s, gave it up; "
            "nothing was taken in; send less in one request"
        )

    def _processor_s(self) -> float:
        """Processor time that the process has used; the clock's where the system does not tell."""
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return time.monotonic()
        return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S

    def _await_start(self) -> None:
        """Wait until the process is ready; raises BusyError where that takes long, EOFError in the end."""
        if not self._answered.poll(1000.0 * _START_WAIT_S):
            if time.monotonic() - self._begun > _START_S:
                raise EOFError
            raise BusyError("expected a worker that is ready, it is still starting; come again", 5)
        self._connection.recv()
        self._ready = True

    def _replace(self) -> None:
        self._process.kill()
        self._process.join()
        self._connection.close()
        if self._stopped:
            raise DrainingError("expected a server that runs on, it is about to stop; come again")
        self.start()


class LocalWorker:
    """Does tasks in the thread that brings them: for tests, and where processes are not wanted."""

    def __init__(self, context: TaskContext) -> None:
        self._context, self._turn = context, threading.Lock()

    def start(self) -> None:
        """Nothing has to be started."""

    def stop(self) -> None:
        """Nothing has to be stopped."""

    def fold(self, job: Job) -> Folded:
        """Fold a job."""
        return self.do(job)

    def do(self, task: Task[T]) -> T:
        """Do a task."""
        with self._turn:
            try:
                return task.run(self._context)
            except MemoryError as error:
                raise StepTooLargeError("expected work that fits into memory") from error
