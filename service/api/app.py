"""The application: ``create_app(settings)``; nothing happens before that, and little before it starts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import import_module, metadata

from fastapi import Depends, FastAPI

from service.api import problems
from service.api.admission import Admission
from service.api.context import Context
from service.api.jobs import JobRunner
from service.api.middleware import RequestMiddleware
from service.api.openapi import Description, operation_id
from service.api.parameters import known_parameters
from service.api.routes import (
    echoes,
    events,
    health,
    jobs,
    measurements,
    pages,
    pdus,
    sessions,
    state,
    streams,
    uploads,
)
from service.api.telemetry import Metrics
from service.settings import Settings
from service.storage.database import opened

__all__ = ["create_app"]

_LISTENS_S = 0.3  # after the application has started
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
        with opened(settings.url, settings.lock_timeout_s) as engine:
            here.open(engine)
            here.workers.start()
            loading = asyncio.create_task(_load_engine(here))
            runner = JobRunner(here)
            try:
                yield
            finally:
                loading.cancel()
                await runner.stop()
                here.workers.stop()

    app = FastAPI(
        title="hapslam",
        version=_version(),
        description=_DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        responses=problems.PROBLEM_RESPONSES,
        generate_unique_id_function=operation_id,
        dependencies=[Depends(known_parameters)],
    )
    app.state.context = here
    problems.install(app)
    app.add_middleware(Admission, here=here)
    app.add_middleware(RequestMiddleware, metrics=here.metrics, timeout_s=settings.request_timeout_s)
    for module in (
        health,
        sessions,
        echoes,
        measurements,
        streams,
        pdus,
        uploads,
        jobs,
        state,
        events,
        pages,
    ):
        app.include_router(module.router)
    app.openapi = Description(app)  # type: ignore[method-assign]
    return app


async def _load_engine(here: Context) -> None:
    """Import what sessions are checked with, once the server listens: the first of them need not wait."""
    await asyncio.sleep(_LISTENS_S)
    await here.run(import_module, "estimator.slam.run")


def _version() -> str:
    try:
        return metadata.version("hapslam")
    except metadata.PackageNotFoundError:
        return "0"
