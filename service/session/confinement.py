"""What a process may do while it reads files of strangers, and how much memory it may take.

The structure of a file is checked before it is read (:mod:`estimator.hdf5_guard`); this is the second
line: whatever a reader is talked into, the kernel gives it no second file, no socket and no more memory.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from estimator.errors import FileFormatError, FileTooLargeError, HapslamError

try:
    import resource
except ImportError:  # not on Windows, where files are still checked before they are read
    resource = None  # type: ignore[assignment]

__all__ = ["confine", "confined_reading", "limit_memory"]

_STATUS = Path("/proc/self/status")
_confined = False  # whether files are read one at a time: in a worker that has read one of each kind


def confine() -> None:
    """From now on this process opens no other file while it reads one of a stranger's."""
    global _confined
    _confined = True


def limit_memory(most_bytes: int) -> None:
    """Let this process have at most so much memory; what asks for more gets MemoryError.

    The kernel counts private memory that is mapped, used or not; what is mapped at the time of the call
    without being used is allowed on top.
    """
    if resource is None or not _STATUS.exists():
        return
    sizes = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines() if ":" in line)
    data, resident = (1024 * int(sizes[name].split()[0]) for name in ("VmData", "VmRSS"))
    allowed = data + max(0, most_bytes - resident)
    resource.setrlimit(resource.RLIMIT_DATA, (allowed, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


@contextmanager
def confined_reading() -> Iterator[None]:
    """Read a file of a stranger: one open file at a time, in a worker, and no errors of libraries.

    Raises
    ------
    FileTooLargeError
        If the reader ran out of memory.
    FileFormatError
        If the reader failed in any way that is not an error of ours; what the library said is not
        repeated, for it may tell of other files.
    """
    try:
        with _one_file():
            yield
    except HapslamError:
        raise
    except MemoryError as error:
        raise FileTooLargeError("file: expected one that can be read in the memory of a worker") from error
    except Exception as error:
        raise FileFormatError(
            f"file: expected one that can be read, its reader failed over it ({type(error).__name__})"
        ) from error


@contextmanager
def _one_file() -> Iterator[None]:
    """Leave this process one free file descriptor; the threads of a server keep theirs."""
    if resource is None or not _confined:
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    free = os.dup(0)
    os.close(free)  # the lowest free number: descriptors are given in order
    resource.setrlimit(resource.RLIMIT_NOFILE, (free + 1, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
