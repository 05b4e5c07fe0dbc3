"""Tasks that are slow, greedy or deadly; a worker imports this, so it imports little."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

from estimator.errors import InputError
from service.session.tasks import TaskContext


@dataclass(frozen=True)
class Nap:
    """Takes its time, step by step, and says in which process."""

    seconds: float
    step: str = ""

    def run(self, context: TaskContext) -> int:
        """Sleep."""
        if self.step:
            context.begin_step(self.step)
        time.sleep(self.seconds)
        return os.getpid()


@dataclass(frozen=True)
class Spin:
    """Computes for so many seconds of processor time."""

    seconds: float

    def run(self, context: TaskContext) -> int:
        """Compute."""
        context.begin_step("epoch 7 (3 anchors, 90 paths)")
        while time.process_time() < self.seconds:
            pass
        return os.getpid()


@dataclass(frozen=True)
class Hoard:
    """Takes memory."""

    mebibytes: int

    def run(self, context: TaskContext) -> int:
        """Take it."""
        context.begin_step("epoch 8 (64 anchors, 12800 paths)")
        return len(bytearray(self.mebibytes * 2**20))


@dataclass(frozen=True)
class Stumble:
    """Fails over something that failed over something, so many times."""

    times: int

    def run(self, context: TaskContext) -> int:
        """Fail."""
        from tblib import pickling_support  # of a development tool: causes and frames travel, too

        pickling_support.install()
        try:
            if self.times:
                Stumble(self.times - 1).run(context)
        except Exception as error:
            raise InputError(f"expected less than {self.times}") from error
        raise InputError("expected at least one")


@dataclass(frozen=True)
class Crash:
    """Takes its process along."""

    def run(self, context: TaskContext) -> int:
        """End the process."""
        del context
        os._exit(3)
