"""The application: ``create_app(settings)``; nothing happens before that, and little before it starts."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import metadata

import anyio
from fastapi import FastAPI
from starlette.middleware.body_limit import RequestBodyLimitMiddleware

from service import problems
from service.auth import KeyRing
from service.context import Context
from service.database import opened
from service.middleware import RequestMiddleware
from service.routes import echoes, events, health, measurements, pages, sessions, state, uploads
from service.settings import Settings
from service.store import Store
from service.telemetry import Metrics
from service.workers import StepPool

__all__ = ["create_app"]

_THREADS = 48

_DESCRIPTION = """\
Measurements in, SLAM state out. Make a session, post the walls sensed at the start to its
`sweeps`, then paths to its `epochs`; read `state`, `trajectory` and `map`, or follow `events`.

Positions are metres in the estimator's frame (origin: where the agent started; axes: those of its
arrays there) unless the session states its start frame. Errors are problem documents (RFC 9457).
"""


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
        here.threads = anyio.CapacityLimiter(_THREADS)
        pool = StepPool(settings.workers, settings.max_waiting, settings.request_timeout_s)
        with opened(settings.url, settings.lock_timeout_s) as engine, pool as here.pool:
            here.store, here.keys = Store(engine), KeyRing(engine)
            yield

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
    app.add_middleware(RequestBodyLimitMiddleware, max_body_size=settings.max_body_bytes)
    app.add_middleware(
        RequestMiddleware,
        metrics=here.metrics,
        timeout_s=settings.request_timeout_s,
        max_body_bytes=settings.max_body_bytes,
    )
    for module in (health, sessions, echoes, measurements, uploads, state, events, pages):
        app.include_router(module.router)
    return app


def _version() -> str:
    try:
        return metadata.version("hapslam")
    except metadata.PackageNotFoundError:
        return "0"
