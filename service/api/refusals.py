"""The one table from exceptions to answers (RFC 9457)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sqlalchemy.exc import DBAPIError, IntegrityError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from estimator.errors import FileFormatError, FileTooLargeError, InputError
from service.errors import (
    AuthenticationError,
    BusyError,
    ConflictError,
    DrainingError,
    ForbiddenError,
    NotFoundError,
    SlowBodyError,
    StepTooLargeError,
    StepTooLongError,
    TooLargeError,
    TooManyError,
    UnsupportedMediaError,
    ValidationError,
    WorkerDiedError,
)

__all__ = ["Refusal", "refusal"]


@dataclass(frozen=True)
class Refusal:
    """How an exception is answered.

    Parameters
    ----------
    status : int
        HTTP status.
    kind : str
        Last part of the problem's type.
    title : str
        What kind of problem it is.
    retry_after_s : int, optional
        When to come again.
    detail : str, optional
        Said instead of the exception's message, where that is not the client's business.
    """

    status: int
    kind: str
    title: str
    retry_after_s: int | None = None
    detail: str | None = None


_TABLE: tuple[tuple[type[BaseException] | tuple[type[BaseException], ...], Refusal], ...] = (
    (NotFoundError, Refusal(404, "not-found", "Not found")),
    (ConflictError, Refusal(409, "conflict", "The session is elsewhere")),
    (AuthenticationError, Refusal(401, "authentication", "An API key is needed")),
    (ForbiddenError, Refusal(403, "forbidden", "Not allowed from there")),
    ((TooLargeError, FileTooLargeError), Refusal(413, "too-large", "Too large")),
    (UnsupportedMediaError, Refusal(415, "media-type", "Of another media type")),
    (TooManyError, Refusal(429, "too-many-sessions", "Too many sessions", 3600)),
    (BusyError, Refusal(429, "busy", "Busy", 1)),
    (ValidationError, Refusal(422, "validation", "The request is not what was expected")),
    (StepTooLongError, Refusal(422, "step-too-long", "The step takes too long")),
    (StepTooLargeError, Refusal(422, "step-too-large", "The step takes too much memory")),
    (SlowBodyError, Refusal(408, "slow-body", "The body did not come")),
    (DrainingError, Refusal(503, "draining", "The server is about to stop", 5)),
    (WorkerDiedError, Refusal(503, "worker-died", "The worker died", 1)),
    (FileFormatError, Refusal(422, "file-format", "The file is not what was expected")),
    (InputError, Refusal(422, "input", "The input is not what was expected")),
    (TimeoutError, Refusal(504, "timeout", "The request took too long", 1)),
    (PoolTimeoutError, Refusal(503, "busy-database", "The database is busy", 1, "no connection was free")),
)

_DATABASE: tuple[tuple[tuple[str, ...], Refusal], ...] = (
    (
        ("disk is full", "no space left", "could not extend file"),
        Refusal(507, "disk-full", "The disk is full", 60, "nothing was taken in; make room on the disk"),
    ),
    (
        ("readonly", "read-only"),
        Refusal(503, "read-only", "The database is read-only", 60, "nothing was taken in; make it writable"),
    ),
    (
        ("locked", "busy", "lock timeout", "deadlock"),
        Refusal(503, "locked", "The database is locked", 1, "nothing was taken in; come again"),
    ),
)
_UNREACHABLE = Refusal(
    503, "database", "The database cannot be reached", 2, "nothing is known to have been taken in; come again"
)
_BUG = Refusal(500, "internal", "Internal error", None, "the server's log says more under this request id")


def refusal(error: BaseException) -> Refusal:
    """How ``error`` is answered."""
    for kind, answer in _TABLE:
        if isinstance(error, kind):
            return replace(answer, retry_after_s=getattr(error, "retry_after_s", answer.retry_after_s))
    if isinstance(error, DBAPIError) and not isinstance(error, IntegrityError):
        text = str(error.orig).lower()
        for words, answer in _DATABASE:
            if any(word in text for word in words):
                return answer
        if error.connection_invalidated or isinstance(error, (OperationalError, InterfaceError)):
            return _UNREACHABLE
    return _BUG
