"""A process that does one task at a time, within limits of memory and time.

What exceeds a limit, or crashes, takes its process along and no more: the process is replaced, and the
one who sent the task is told. Processes end with the server, even if it was killed.
"""

from __future__ import annotations

import multiprocessing
import os
import select
import threading
import time
from pathlib import Path
from typing import Any, TypeVar

from service.errors import BusyError, DrainingError, StepTooLargeError, StepTooLongError, WorkerDiedError
from service.session.fold import Job
from service.session.tasks import Task, TaskContext, WorkerSetup
from service.session.worker_process import serve
from service.storage.folded import Folded

__all__ = ["LocalWorker", "Worker"]

T = TypeVar("T")
_START_S = 300.0  # until a process is ready: on a new machine it compiles the engine first
_START_WAIT_S = 30.0  # that a request waits for it
_PATIENCE = 4.0  # of the wall clock beside processor time: a niced process may wait for its turn
_TICKS_PER_S = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


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
        self._begin(first=True)

    def _begin(self, first: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, self._setup, first), daemon=True)
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
        """Fold a job; raises as :meth:`do` and :func:`service.session.fold.fold`."""
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
        kind, _ = self._connection.recv()
        if kind == "compiled":
            self._end()
            self._begin(first=False)
            self._await_start()
        self._ready = True

    def _replace(self) -> None:
        self._end()
        self.start()

    def _end(self) -> None:
        """End the process for another; raises DrainingError if there is to be none."""
        self._process.kill()
        self._process.join()
        self._connection.close()
        if self._stopped:
            raise DrainingError("expected a server that runs on, it is about to stop; come again")


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
