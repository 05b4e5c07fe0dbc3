"""Progress of long work on the standard error: bars on a terminal, else lines.

Where nobody watches a terminal, a stage has a line when it ends and, if it is long, one every
now and then of how far it is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from service.cli.console import plain_console

__all__ = ["Advance", "Reporter"]

Advance = Callable[..., None]

# Without a terminal, long enough to keep a log short, short enough to see that work goes on.
_EVERY_S = 15.0


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
        self._console = plain_console(stderr=True, quiet=quiet, soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text)

    @contextmanager
    def stage(self, name: str) -> Iterator[Advance]:
        """Run a stage; the callable takes (done, total) and at will a text of what comes next."""
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        begin = time.perf_counter()
        live = self._console.is_terminal and not self._console.quiet
        columns = (
            TextColumn("{task.description:<9}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}", markup=False),
        )
        with (
            Progress(*columns, console=self._console, transient=True, disable=not live) as bar,
            _beating(name, None if live or self._console.quiet else self.say) as reached,
        ):
            task = bar.add_task(name, total=None, text="")

            def advance(done: int, total: int, text: str = "") -> None:
                bar.update(task, completed=done, total=total, text=text)
                reached(f"{done} of {total}" + (f", {text}" if text else ""))

            yield advance
        self.seconds[name] = time.perf_counter() - begin
        self.say(f"{name:<9} {self.seconds[name]:6.1f} s")


@contextmanager
def _beating(name: str, say: Callable[[str], None] | None) -> Iterator[Callable[[str], None]]:
    """Say every now and then how far a stage is; the callable takes what was reached."""
    begin, state, ended = time.perf_counter(), ["starting"], threading.Event()

    def reached(text: str) -> None:
        state[0] = text

    def beat(say: Callable[[str], None]) -> None:
        while not ended.wait(_EVERY_S):
            say(f"{name:<9} {time.perf_counter() - begin:6.0f} s, {state[0]}")

    if say is None:
        yield reached
        return
    thread = threading.Thread(target=beat, args=(say,), daemon=True)
    thread.start()
    try:
        yield reached
    finally:
        ended.set()
        thread.join()
