"""The client of the service."""

from service.client.calls import Client, ServiceUnavailableError, UnexpectedAnswerError

__all__ = ["Client", "ServiceUnavailableError", "UnexpectedAnswerError"]
