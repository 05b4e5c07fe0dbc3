"""How many event streams a key has open."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import BusyError

__all__ = ["Streams"]


class Streams:
    """Counts the streams of each key.

    Parameters
    ----------
    most : int
        That a key may have open.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: Counter[str | None] = Counter()

    def check(self, key: str | None) -> None:
        """Raise BusyError if a key has as many streams as it may."""
        if self._open[key] >= self._most:
            raise BusyError(f"expected at most {self._most} event streams of a key; close some", 5)

    @contextmanager
    def opened(self, key: str | None) -> Iterator[None]:
        """Count a stream while it is open."""
        self._open[key] += 1
        try:
            yield
        finally:
            self._open[key] -= 1
            if not self._open[key]:
                del self._open[key]
