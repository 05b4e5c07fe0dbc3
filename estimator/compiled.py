"""Functions compiled to machine code on first use, and kept for the next process.

The arithmetic of a hypothesis is small: interpreted, it costs thirty times what it costs compiled. Compiled
functions are plain loops over arrays. They are compiled without ``fastmath`` and without threads, so that results
are the same bits whatever the number of cores. The machine code is kept beside the source or, where that may not be
written, in the user's cache folder (Numba's rule; ``NUMBA_CACHE_DIR`` overrides it). With
``NUMBA_DISABLE_JIT=1`` the same functions run as Python, for a debugger or to measure coverage.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

__all__ = ["announce_compilation", "cache_folder", "compiled"]

F = TypeVar("F", bound=Callable[..., Any])
_FUNCTIONS: list[Any] = []


def compiled(function: F) -> F:
    """Decorate a function so that it is compiled for the types that it is called with.

    Division by zero gives infinity, as NumPy's; array bounds are not checked (``NUMBA_BOUNDSCHECK=1`` checks them).
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        dispatcher = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder that may be written: compiled anew in each process
        dispatcher = numba.njit(**options)(function)
    _FUNCTIONS.append(dispatcher)
    return cast(F, dispatcher)


def cache_folder() -> Path | None:
    """The folder that keeps the machine code of the functions decorated so far; None if nothing is kept."""
    for function in _FUNCTIONS:
        path = getattr(getattr(function, "_cache", None), "cache_path", None)
        if path is not None:
            return Path(path)
    return None


class _Announcer(event.Listener):  # type: ignore[misc]
    """Calls ``write`` once, when the first function is compiled rather than loaded."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self.write: Callable[[str], None] | None = write

    def on_start(self, event: Any) -> None:
        """A function is compiled now."""
        if self.write is not None:
            write, self.write = self.write, None
            write("compiling the estimator for this machine, once (about half a minute)")

    def on_end(self, event: Any) -> None:
        """It has been compiled."""


def announce_compilation(write: Callable[[str], None]) -> None:
    """Have ``write`` told in one line when functions are compiled in this process; loading them is silent."""
    event.register("numba:compile", _Announcer(write))
