"""The exception tree of hapslam.

Every error that a user can cause derives from :class:`HapslamError`; its message
names what was wrong, what was expected and what came. The command line prints the
message on one line and exits with status 2; nothing else is caught.
"""

from __future__ import annotations

__all__ = [
    "BackendError",
    "ConfigurationError",
    "FileFormatError",
    "FileTooLargeError",
    "HapslamError",
    "InputError",
    "OutputExistsError",
    "WorkerLostError",
]


class HapslamError(Exception):
    """Base of all errors raised on purpose."""


class InputError(HapslamError, ValueError):
    """An argument, file or measurement is not what was expected."""


class ConfigurationError(InputError):
    """A configuration value is outside its range."""


class FileFormatError(InputError):
    """A file is missing, truncated, of another format or of an unknown version."""


class FileTooLargeError(FileFormatError):
    """A file holds, or would unpack to, more than is read."""


class OutputExistsError(InputError):
    """The place to write to exists; nothing was written."""


class BackendError(HapslamError, RuntimeError):
    """The ray tracer or a cluster cannot run here; the message holds the remedy."""


class WorkerLostError(BackendError):
    """A process that did a part of the work was killed, by the system perhaps."""
