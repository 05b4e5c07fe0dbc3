"""Machine code kept on disk: each function compiled by one process at a time, old versions removed.

Processes that start together, as workers do, want the same functions. Who finds one missing locks it; the
others wait and load what was compiled. Without the lock all would compile, and two that keep a function for
different types at once could swap their files. What a function calls is locked inside its own lock: calls
have no circles, so neither have the locks. A folder that cannot lock goes without.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile

__all__ = ["KeptCode"]

_VERSIONS_KEPT = 4  # of a function, newest first: those of a few branches that one goes to and fro between


class KeptCode(FunctionCache):  # type: ignore[misc]
    """The machine code of one function, under a name that has a mark of its sources.

    Parameters
    ----------
    function : callable
        The Python function.
    mark : str
        What tells its sources from others, hexadecimal digits.

    Raises
    ------
    RuntimeError
        If there is no folder that may be written.
    """

    def __init__(self, function: Any, mark: str) -> None:
        super().__init__(function)
        self._base = self._impl.filename_base
        self._place = int(mark, 16)
        self._cache_file = IndexDataCacheFile(self.cache_path, f"{self._base}-{mark}", mark)
        self._locked = False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code for a signature; if there is none, the function is locked until :meth:`release`."""
        found = super().load_overload(sig, target_context)
        if found is None and not self._locked:
            self._locked = _lock(Path(self.cache_path), self._place)
            if self._locked:
                found = super().load_overload(sig, target_context)
                if found is not None:
                    self.release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature, and let others have it."""
        try:
            super().save_overload(sig, data)
            _remove_old(Path(self.cache_path), self._base)
        finally:
            self.release()

    def release(self) -> None:
        """Unlock the function: it is kept, or could not be compiled."""
        if self._locked:
            self._locked = False
            _unlock(Path(self.cache_path), self._place)


_LOCK_FILES: dict[tuple[Path, int], int] = {}  # of folders and processes: a lock ends when its file is closed


def _lock(folder: Path, place: int) -> bool:
    """Wait for the lock of a function; whether it could be had."""
    try:
        if (folder, os.getpid()) not in _LOCK_FILES:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder / "compiling.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            _LOCK_FILES[folder, os.getpid()] = descriptor
        fcntl.lockf(_LOCK_FILES[folder, os.getpid()], fcntl.LOCK_EX, 1, place)
    except OSError:
        return False
    return True


def _unlock(folder: Path, place: int) -> None:
    """Let others compile a function."""
    with contextlib.suppress(OSError):
        fcntl.lockf(_LOCK_FILES[folder, os.getpid()], fcntl.LOCK_UN, 1, place)


def _remove_old(folder: Path, base: str) -> None:
    """Remove all but the newest versions of a function, wherever in its file it stood."""
    name, python = re.fullmatch(r"(.*)-\d+(\.py\d+\w*)", base).groups()  # type: ignore[union-attr]
    version = re.compile(rf"{re.escape(name)}-\d+{re.escape(python)}-[0-9a-f]+\.nbi")
    with contextlib.suppress(OSError):  # another process removes them at the same time
        found = [path for path in folder.glob("*.nbi") if version.fullmatch(path.name)]
        for index in sorted(found, key=lambda path: path.stat().st_mtime)[:-_VERSIONS_KEPT]:
            for data in folder.glob(f"{index.stem}.*.nbc"):
                data.unlink(missing_ok=True)
            index.unlink(missing_ok=True)
