"""Query parameters that no route knows are refused: a misspelt one would be passed over in silence."""

from __future__ import annotations

from fastapi.dependencies.models import Dependant
from fastapi.requests import HTTPConnection
from fastapi.routing import APIRoute
from pydantic import BaseModel

from service.errors import ValidationError

__all__ = ["known_parameters"]


async def known_parameters(request: HTTPConnection) -> None:
    """Raise ValidationError where a request has a query parameter that its route does not have."""
    route = request.scope.get("route")
    if not request.query_params or not isinstance(route, APIRoute):
        return
    known = _names(route.dependant)
    for name in request.query_params:
        if name not in known:
            expected = f"one of {', '.join(sorted(known))}" if known else "no parameters"
            found = {"where": f"query.{name[:64]}", "expected": expected, "got": name[:64]}
            raise ValidationError(f"query: expected {expected}, got {name[:64]!r}", [found])


def _names(dependant: Dependant) -> set[str]:
    """Query parameters of a route and of what it depends on."""
    found = set[str]().union(*map(_names, dependant.dependencies))
    for parameter in dependant.query_params:
        kind = parameter.field_info.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            found |= kind.model_fields.keys()
        else:
            found.add(parameter.alias)
    return found
