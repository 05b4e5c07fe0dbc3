"""Errors of the service; :mod:`service.api.refusals` says how each is answered."""

from __future__ import annotations

from estimator.errors import HapslamError

__all__ = [
    "AuthenticationError",
    "BusyError",
    "ConflictError",
    "DatabaseError",
    "DrainingError",
    "ForbiddenError",
    "NotFoundError",
    "ServiceError",
    "SlowBodyError",
    "StepTooLargeError",
    "StepTooLongError",
    "TooLargeError",
    "TooManyError",
    "UnsupportedMediaError",
    "ValidationError",
    "WorkerDiedError",
]


class ServiceError(HapslamError):
    """Base of the service's own errors."""


class DatabaseError(ServiceError):
    """The database cannot be opened."""


class NotFoundError(ServiceError):
    """There is no such thing, or not for this caller."""


class ConflictError(ServiceError):
    """The session is not where the request takes it to be."""

    def __init__(self, message: str, expected: dict[str, object] | None = None) -> None:
        super().__init__(message)
        self.expected = expected or {}


class AuthenticationError(ServiceError):
    """No valid API key came with the request."""


class ForbiddenError(ServiceError):
    """The request is not allowed from where it comes."""


class TooLargeError(ServiceError):
    """The request exceeds a size that the operator set."""


class UnsupportedMediaError(ServiceError):
    """The body is of a type, or packed in a way, that the route does not read."""


class TooManyError(ServiceError):
    """The caller has as many sessions as allowed."""


class BusyError(ServiceError):
    """There is enough to do, or the key has used up its share; come again."""

    def __init__(self, message: str, retry_after_s: int = 1) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class DrainingError(ServiceError):
    """The server is about to stop."""


class SlowBodyError(ServiceError):
    """The body did not come."""


class StepTooLongError(ServiceError):
    """What was sent takes too long and was given up; the same again would, too."""


class StepTooLargeError(ServiceError):
    """What was sent takes too much memory and was given up; the same again would, too."""


class WorkerDiedError(ServiceError):
    """A worker died over a step."""


class ValidationError(ServiceError):
    """A body is not what was expected; ``found`` says where, what was expected and what came."""

    def __init__(self, message: str, found: list[dict[str, str]] | None = None) -> None:
        super().__init__(message)  # what else there is travels between processes with the state
        self.found = found or []
