"""JSON bodies that may be large: parsed and checked where it stops nobody else."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import pydantic
from pydantic import BaseModel

from service.errors import ValidationError
from service.messages.epochs import EpochsRequest
from service.messages.terms import SessionTerms
from service.messages.truth import Truth
from service.messages.violations import violations
from service.session.entries import EpochEntry, EpochLimits, entries_of
from service.session.tasks import TaskContext

__all__ = ["EpochsTask", "ParseTask", "TruthTask", "json_content", "parsed", "parsed_by"]

Model = TypeVar("Model", bound=BaseModel)
T = TypeVar("T")


def parsed(model: type[Model], body: bytes) -> Model:
    """A body as a model; raises ValidationError."""
    return parsed_by(model.model_validate, body)


def parsed_by(validate: Callable[[Any], T], body: bytes) -> T:
    """A body as a function of Pydantic's makes it; raises ValidationError."""
    try:
        return validate(_json(body))
    except pydantic.ValidationError as error:
        entries: list[dict[str, Any]] = [
            {**entry, "loc": ("body", *entry["loc"])} for entry in error.errors(include_url=False)
        ]
        raise _refused(violations(entries)) from error


def _json(body: bytes) -> Any:
    try:
        return json.loads(body)
    except json.JSONDecodeError as error:
        entry = {
            "type": "json_invalid",
            "loc": ("body", error.pos),
            "msg": "JSON decode error",
            "input": {},
            "ctx": {"error": error.msg},
        }
        raise _refused(violations([entry], error.doc)) from error
    except (
        ValueError,
        RecursionError,
    ) as error:  # no UTF-8, a number of thousands of digits, nested too deeply
        reason = "expected JSON in UTF-8, not nested deeply, with numbers of usual length"
        raise _refused([{"where": "body", "expected": reason, "got": f"{len(body)} bytes"}]) from error


def _refused(found: list[dict[str, str]]) -> ValidationError:
    first = found[0]
    return ValidationError(f"{first['where']}: {first['expected']}, got {first['got']}", found)


@dataclass(frozen=True)
class EpochsTask:
    """Epochs of a request as entries of the log.

    Parameters
    ----------
    body : bytes
        The request's body.
    terms : SessionTerms
        The session's.
    limits : EpochLimits
        How much it may bring.
    """

    body: bytes
    terms: SessionTerms
    limits: EpochLimits

    def run(self, context: TaskContext) -> tuple[EpochEntry, ...]:
        """Parse; raises ValidationError, InputError or TooLargeError."""
        del context
        request = parsed(EpochsRequest, self.body)
        self.limits.check_count(len(request.epochs))
        found = entries_of((entry.estimator_epoch(self.terms) for entry in request.epochs), self.limits)
        return tuple(
            replace(made, frame_time=True) if given.frame_time else made
            for made, given in zip(found, request.epochs, strict=True)
        )


@dataclass(frozen=True)
class ParseTask(Generic[Model]):
    """A body as a model.

    Parameters
    ----------
    model : type
        The model.
    body : bytes
        The request's body.
    """

    model: type[Model]
    body: bytes

    def run(self, context: TaskContext) -> Model:
        """Parse; raises ValidationError."""
        del context
        return parsed(self.model, self.body)


@dataclass(frozen=True)
class TruthTask:
    """A truth as the database keeps it.

    Parameters
    ----------
    body : bytes
        The request's body.
    """

    body: bytes

    def run(self, context: TaskContext) -> str:
        """Parse; raises ValidationError. Text is what comes back quickly from a process."""
        del context
        return parsed(Truth, self.body).model_dump_json()


def json_content(model: type[BaseModel], binary: bool = False) -> dict[str, Any]:
    """What the interface's description says of a body that a route parses itself, or takes as a file too."""
    schema = {"$ref": f"#/components/schemas/{model.__name__}"}
    content: dict[str, Any] = {"application/json": {"schema": schema}}
    if binary:
        content["application/octet-stream"] = {"schema": {"type": "string", "format": "binary"}}
    return {"requestBody": {"required": True, "content": content}}
