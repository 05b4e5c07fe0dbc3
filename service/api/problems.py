"""Every error answer has one shape: a problem document (RFC 9457)."""

from __future__ import annotations

from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.routing import Match

from estimator.errors import HapslamError
from service.api.refusals import refusal
from service.errors import ConflictError, UnsupportedMediaError, ValidationError
from service.messages.violations import WIDTH, violations

__all__ = ["PROBLEM_RESPONSES", "install", "problem"]

_MEDIA_TYPE = "application/problem+json"


def problem(error: BaseException, request_id: str) -> JSONResponse:
    """The answer to an exception."""
    answer = refusal(error)
    more: dict[str, Any] = {}
    if isinstance(error, ConflictError):
        more["expected"] = error.expected
    if isinstance(error, ValidationError):
        more["errors"] = error.found
    if answer.status >= 500:
        structlog.get_logger().error("failed", kind=answer.kind, exc_info=error)
    return _document(
        answer.status,
        answer.kind,
        answer.title,
        answer.detail or str(error),
        request_id,
        answer.retry_after_s,
        **more,
    )


def _document(
    status: int,
    kind: str,
    title: str,
    detail: str,
    request_id: str,
    retry_after_s: int | None = None,
    **more: Any,
) -> JSONResponse:
    headers = {} if retry_after_s is None else {"Retry-After": str(retry_after_s)}
    if status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    content = {
        "type": f"urn:hapslam:problem:{kind}",
        "title": title,
        "status": status,
        "detail": detail.encode("utf-8", "replace").decode(),
        "request_id": request_id,
        **more,
    }
    return JSONResponse(content, status, headers, _MEDIA_TYPE)


def _request_id(request: Request) -> str:
    return str(getattr(request.state, "request_id", ""))


async def _on_error(request: Request, error: Exception) -> JSONResponse:
    return problem(error, _request_id(request))


async def _on_validation(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    if any(entry["loc"] == ("body",) and isinstance(entry.get("input"), bytes) for entry in error.errors()):
        given = request.headers.get("content-type", "none")[:WIDTH]
        expected = "expected a body of the type application/json"
        return problem(UnsupportedMediaError(f"{expected}, got {given}"), _request_id(request))
    found = violations(error.errors(), error.body)
    first = found[0] if found else {"where": "request", "expected": "something else", "got": ""}
    detail = f"{first['where']}: {first['expected']}, got {first['got']}"
    return _document(
        422, "validation", "The request is not what was expected", detail, _request_id(request), errors=found
    )


async def _on_http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    asked = f"{request.method} {request.url.path[:WIDTH]}"
    headers = dict(error.headers or {})
    if error.status_code == 405:
        headers["Allow"] = ", ".join(_methods(request))
    detail = {
        404: f"expected an address that /docs tells of, got {asked}",
        405: f"expected {headers.get('Allow')}, got {asked}",
    }.get(error.status_code, str(error.detail))
    response = _document(error.status_code, "http", "The request was refused", detail, _request_id(request))
    response.headers.update(headers)
    return response


def _methods(request: Request) -> list[str]:
    """What can be done at the address of a request."""
    asked = {**request.scope, "path_params": {}}
    return [
        method
        for method in ("GET", "POST", "PUT", "PATCH", "DELETE")
        if any(route.matches({**asked, "method": method})[0] is Match.FULL for route in request.app.routes)
    ]


def install(app: FastAPI) -> None:
    """Have all errors of an application answered as problems."""
    app.add_exception_handler(RequestValidationError, _on_validation)
    app.add_exception_handler(HTTPException, _on_http)
    for kind in (HapslamError, SQLAlchemyError):
        app.add_exception_handler(kind, _on_error)


_SCHEMA = {"$ref": "#/components/schemas/Problem"}
_AGAIN = {"Retry-After": {"description": "Seconds after which to come again.", "schema": {"type": "integer"}}}
_MOMENTARY = (429, 503, 504, 507)

PROBLEM_RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {
        "description": text,
        "content": {_MEDIA_TYPE: {"schema": _SCHEMA}},
        **({"headers": _AGAIN} if status in _MOMENTARY else {}),
    }
    for status, text in (
        (400, "The request cannot be read"),
        (401, "An API key is needed"),
        (403, "Not allowed from there"),
        (404, "No such thing of yours"),
        (408, "The body did not come"),
        (409, "The session expects something else next"),
        (413, "Too large"),
        (415, "Of another media type"),
        (422, "Not what was expected"),
        (429, "Busy, or too many"),
        (503, "Out of order for the moment"),
        (504, "Took too long"),
        (507, "The disk is full"),
    )
}
