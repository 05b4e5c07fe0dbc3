"""The application: ``create_app(settings)``; nothing happens before that, and little before it starts."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import metadata
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from service.api import problems
from service.api.admission import Admission
from service.api.context import Context
from service.api.middleware import RequestMiddleware
from service.api.routes import (
    echoes,
    events,
    health,
    measurements,
    pages,
    pdus,
    sessions,
    state,
    streams,
    uploads,
)
from service.api.telemetry import Metrics
from service.messages.epochs import EpochsRequest
from service.messages.session_requests import SessionRequest
from service.messages.sweeps import SweepRequest
from service.messages.truth import Truth
from service.settings import Settings
from service.storage.database import opened

__all__ = ["create_app"]

_DESCRIPTION = """\
Measurements in, SLAM state out. Make a session, post the walls sensed at the start to its
`sweeps`, then paths to its `epochs`; read `state`, `trajectory` and `map`, or follow `events`.

Positions are metres in the estimator's frame (origin: where the agent started; axes: those of its
arrays there) unless the session states its start frame. Errors are problem documents (RFC 9457).
"""


_BODIES = (SessionRequest, SweepRequest, EpochsRequest, Truth)


def create_app(settings: Settings) -> FastAPI:
    """The service as an ASGI application.

    The database is opened, its tables brought up to date and the workers started when the
    application starts.

    Parameters
    ----------
    settings : Settings
        See :func:`service.settings.load_settings`.
    """
    here = Context(settings, Metrics())

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with opened(settings.url, settings.lock_timeout_s) as engine:
            here.open(engine)
            here.workers.start()
            try:
                yield
            finally:
                here.workers.stop()

    app = FastAPI(
        title="hapslam",
        version=_version(),
        description=_DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        responses=problems.PROBLEM_RESPONSES,
    )
    app.state.context = here
    problems.install(app)
    app.add_middleware(Admission, here=here)
    app.add_middleware(RequestMiddleware, metrics=here.metrics, timeout_s=settings.request_timeout_s)
    for module in (health, sessions, echoes, measurements, streams, pdus, uploads, state, events, pages):
        app.include_router(module.router)
    app.openapi = _Description(app)  # type: ignore[method-assign]
    return app


class _Description:
    """The interface's description, with the bodies that routes parse themselves."""

    def __init__(self, app: FastAPI) -> None:
        self._app, self._document = app, dict[str, Any]()

    def __call__(self) -> dict[str, Any]:
        """The OpenAPI document, made once."""
        if not self._document:
            document = get_openapi(
                title=self._app.title,
                version=self._app.version,
                description=self._app.description,
                routes=self._app.routes,
            )
            models = [(model, "validation") for model in _BODIES]
            _, found = models_json_schema(models, ref_template="#/components/schemas/{model}")  # type: ignore[arg-type]
            document.setdefault("components", {}).setdefault("schemas", {}).update(found["$defs"])
            self._document = document
        return self._document


def _version() -> str:
    try:
        return metadata.version("hapslam")
    except metadata.PackageNotFoundError:
        return "0"
