"""Functions compiled to machine code on first use, and kept for the next process.

The arithmetic of a hypothesis is small: interpreted, it costs thirty times what it costs compiled.
Compiled functions are plain loops over arrays. They are compiled without ``fastmath`` and without
threads, so that results are the same bits whatever the number of cores. The machine code is kept beside
the source or, where that may not be written, in the user's cache folder (Numba's rule;
``NUMBA_CACHE_DIR`` overrides it). With ``NUMBA_DISABLE_JIT=1`` the same functions run as Python, for a
debugger or to measure coverage.

Numba looks only at a function's own file to see whether kept code is stale, not at those of what it calls.
Here the name of what is kept has a fingerprint of all sources that went into it.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import logging
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from estimator.kept_code import KeptCode

__all__ = ["cache_folder", "compiled", "compiled_here"]

F = TypeVar("F", bound=Callable[..., Any])
_LOG = logging.getLogger("hapslam")
_FUNCTIONS: list[Any] = []
_FINGERPRINTS: dict[int, str] = {}


def compiled(function: F) -> F:
    """Decorate a function so that it is compiled for the types that it is called with.

    Division by zero gives infinity, as NumPy's; array bounds are not checked (``NUMBA_BOUNDSCHECK=1``
    checks them).
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    dispatcher = numba.njit(**options)(function)
    _FINGERPRINTS[id(dispatcher)] = mark = _fingerprint(function)
    if dispatcher is not function:  # NUMBA_DISABLE_JIT gives the function itself
        with contextlib.suppress(RuntimeError):  # no folder that may be written: compiled in each process
            dispatcher._cache = KeptCode(function, mark)
    _FUNCTIONS.append(dispatcher)
    return cast(F, dispatcher)


def cache_folder() -> Path | None:
    """The folder that keeps the machine code of the functions decorated so far; None if nothing is kept."""
    for function in _FUNCTIONS:
        path = getattr(getattr(function, "_cache", None), "cache_path", None)
        if path is not None:
            return Path(path)
    return None


def compiled_here() -> bool:
    """Whether this process has compiled a function, rather than loaded what another had compiled.

    What the compiler allocated stays with the process: some hundred MiB for the whole engine.
    """
    return _ANNOUNCER.told


def _fingerprint(function: Callable[..., Any]) -> str:
    """Of a function's file, the compiled functions that it calls, and the constants and types it uses."""
    parts = [function.__module__, _source_mark(function.__module__)]
    for name in sorted(_names(function.__code__)):
        value = function.__globals__.get(name)
        if id(value) in _FINGERPRINTS:
            parts.append(_FINGERPRINTS[id(value)])
        elif isinstance(value, type) and value.__module__.startswith("estimator."):
            parts.append(_source_mark(value.__module__))
        elif isinstance(value, (bool, int, float, tuple)):
            parts.append(repr(value))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def _names(code: CodeType) -> set[str]:
    """Global names that code refers to, that of functions inside it included."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*(_names(each) for each in inner))


@cache
def _source_mark(module: str) -> str:
    """A fingerprint of a module's file."""
    found: ModuleType = sys.modules[module]
    path = inspect.getsourcefile(found)
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else module


class _Announcer(event.Listener):  # type: ignore[misc]
    """Notes once in the log ``hapslam`` that functions are compiled, not loaded."""

    def __init__(self) -> None:
        self.told = False

    def on_start(self, event: Any) -> None:
        """A function is compiled now."""
        if not self.told:
            self.told = True
            _LOG.info("compiling the estimator for this machine, once (about half a minute)")

    def on_end(self, event: Any) -> None:
        """It has been compiled, or could not be."""
        kept = event.data["dispatcher"]._cache
        if event.is_failed and isinstance(kept, KeptCode):
            kept.release()


_ANNOUNCER = _Announcer()
event.register("numba:compile", _ANNOUNCER)
