"""Progress of long work on the standard error: bars on a terminal, else a line per stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

__all__ = ["Advance", "Reporter"]

Advance = Callable[..., None]


class Reporter:
    """Tells how far the stages of a command are, and times them.

    Parameters
    ----------
    quiet : bool
        Say nothing.

    Attributes
    ----------
    seconds : dict of str to float
        Wall-clock seconds of the stages that finished, in their order.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.seconds: dict[str, float] = {}
        self._console = Console(stderr=True, quiet=quiet, highlight=False, soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text, markup=False)

    @contextmanager
    def stage(self, name: str) -> Iterator[Advance]:
        """Run a stage; the callable takes (done, total) and at will a text of what comes next."""
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        begin = time.perf_counter()
        live = self._console.is_terminal and not self._console.quiet
        columns = (
            TextColumn("{task.description:<9}"),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}"),
        )
        with Progress(*columns, console=self._console, transient=True, disable=not live) as bar:
            task = bar.add_task(name, total=None, text="")

            def advance(done: int, total: int, text: str = "") -> None:
                bar.update(task, completed=done, total=total, text=text)

            yield advance
        self.seconds[name] = time.perf_counter() - begin
        self.say(f"{name:<9} {self.seconds[name]:6.1f} s")
