"""Errors of the service; :mod:`service.refusals` says how each is answered."""

from __future__ import annotations

from estimator.errors import HapslamError

__all__ = [
    "AuthenticationError",
    "BusyError",
    "ConflictError",
    "DatabaseError",
    "ForbiddenError",
    "NotFoundError",
    "ServiceError",
    "StepTimeoutError",
    "TooLargeError",
    "TooManyError",
    "UnsupportedMediaError",
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
    """All workers have enough to do; come again."""


class StepTimeoutError(ServiceError):
    """A step took too long and was given up."""


class WorkerDiedError(ServiceError):
    """A worker died over a step."""
