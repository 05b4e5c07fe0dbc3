"""Work for a worker process, what it finds there, and what the process is like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeVar

from service.session.state_cache import StateCache

if TYPE_CHECKING:
    from service.storage.store import Store

__all__ = ["Task", "TaskContext", "WorkerSetup"]

T_co = TypeVar("T_co", covariant=True)


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
