"""One line of the benchmark, and how CPU time is measured."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Row", "cpu_s", "small_operation_us"]

_OPERATIONS = 20_000


@dataclass(frozen=True)
class Row:
    """A figure, with what it is to be held against.

    Parameters
    ----------
    name : str
        What was measured.
    value : float
        The figure; less is better for times and errors.
    unit : str
        Its unit, for instance ``ms``.
    bar : float, optional
        What it must not exceed.
    peer : str, optional
        Another's way of doing the same, run beside it or as stated by its authors.
    peer_value : float, optional
        The peer's figure, in ``unit``.
    """

    name: str
    value: float
    unit: str
    bar: float | None = None
    peer: str | None = None
    peer_value: float | None = None

    @property
    def ratio(self) -> float | None:
        """How many times the peer's figure is this one's."""
        return None if self.peer_value is None or self.value == 0.0 else self.peer_value / self.value

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None without one."""
        return None if self.bar is None else self.value <= self.bar


def cpu_s(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call in this process, all threads together, seconds.

    The first call, which warms caches, is not counted.
    """
    work()
    taken = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return statistics.median(taken)


def small_operation_us() -> float:
    """CPU time that NumPy takes to add ten numbers: it tells a slow or busy machine from slow code."""
    import numpy as np

    ten = np.ones(10)

    def work() -> None:
        for _ in range(_OPERATIONS):
            ten + ten

    return 1e6 * cpu_s(work, 7) / _OPERATIONS
