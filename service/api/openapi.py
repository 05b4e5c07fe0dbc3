"""The interface's description: bodies that routes parse themselves, keys, settings of the noise model."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, is_dataclass
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from service.messages.answers import Problem
from service.messages.epochs import EpochsRequest
from service.messages.session_requests import SessionChange, SessionRequest
from service.messages.sweeps import SweepRequest
from service.messages.truth import Truth

__all__ = ["Description", "described", "operation_id"]

_BODIES = (SessionRequest, SessionChange, SweepRequest, EpochsRequest, Truth, Problem)
_OPEN = ("/livez", "/readyz")
_REF = "#/components/schemas/{model}"


def described(
    model: type[BaseModel], text: str = "Done", media_type: str = "application/json"
) -> dict[Any, Any]:
    """The answer 200 of a route that writes its answer itself."""
    schema = {"$ref": _REF.format(model=model.__name__)}
    return {200: {"model": model, "description": text, "content": {media_type: {"schema": schema}}}}


def operation_id(route: APIRoute) -> str:
    """A route's name in generated clients: that of its function."""
    return route.name.strip("_")


class Description:
    """Makes the OpenAPI document of an application, once.

    Parameters
    ----------
    app : FastAPI
        The application.
    """

    def __init__(self, app: FastAPI) -> None:
        self._app, self._document = app, dict[str, Any]()

    def __call__(self) -> dict[str, Any]:
        """The document."""
        if not self._document:
            self._document = _document(self._app)
        return self._document


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    models = [(model, "validation") for model in _BODIES]
    _, found = models_json_schema(models, ref_template=_REF)  # type: ignore[arg-type]
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas.update(found["$defs"])
    for name in ("SessionRequest", "Session"):
        schemas[name]["properties"]["measurement_model"] = _measurement_model()
    components["securitySchemes"] = {
        "key": {
            "type": "http",
            "scheme": "bearer",
            "description": "An API key (`hapslam key create`) or the key of a share. Where no key has been "
            "made yet, callers on the service's own machine need none.",
        }
    }
    document["security"] = [{"key": []}, {}]
    for path in _OPEN:
        for operation in document["paths"][path].values():
            operation["security"] = []
    return document


def _measurement_model() -> dict[str, Any]:
    """The settings of the engine that a session may state: each with its default and what it means."""
    from estimator.slam.gaussian.config import GaussianConfig  # with the engine: the server starts sooner

    settings: dict[str, Any] = {}
    for group in fields(GaussianConfig):
        kind: Any = group.default_factory
        texts = _parameters(inspect.getdoc(kind) or "")
        for entry in fields(kind):
            default = entry.default
            if isinstance(default, bool) or not isinstance(default, (int, float)):
                continue
            settings[entry.name] = {
                "type": "integer" if isinstance(default, int) else "number",
                "default": default,
                "description": texts.get(entry.name, entry.name.replace("_", " ")),
            }
    assert all(is_dataclass(group.default_factory) for group in fields(GaussianConfig))
    return {
        "type": "object",
        "title": "Measurement model",
        "description": "Settings of the engine by their names; what is left out is default.",
        "properties": dict(sorted(settings.items())),
        "additionalProperties": {"type": "number"},
        "maxProperties": 100,
    }


def _parameters(text: str) -> dict[str, str]:
    """Descriptions of the parameters in a docstring, by name."""
    _, _, section = text.partition("Parameters\n----------\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        head = re.fullmatch(r"([\w, ]+) : .*", line)
        if head:
            names = [name.strip() for name in head[1].split(",")]
        elif line.startswith("    "):
            for name in names:
                found[name] = f"{found.get(name, '')} {line.strip()}".strip()
        elif line.strip():
            break
    return found
