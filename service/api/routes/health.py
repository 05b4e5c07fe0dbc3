"""Whether the service lives, is ready, and what it counts."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from service.api.context import ContextDep

__all__ = ["router"]

router = APIRouter(tags=["operation"])


@router.get("/livez", summary="Whether the process runs")
async def livez() -> dict[str, str]:
    """Answers as long as the process can."""
    return {"status": "alive"}


@router.get("/readyz", summary="Whether requests can be served", responses={503: {"description": "Not now"}})
async def readyz(here: ContextDep) -> JSONResponse:
    """The database answers and the server is not about to stop."""
    if here.draining:
        return JSONResponse({"status": "draining"}, 503)
    if not await here.readiness.ready(here.store.engine):
        return JSONResponse({"status": "no database"}, 503)
    return JSONResponse({"status": "ready"})


@router.get("/metrics", summary="Counters for Prometheus", response_class=Response)
async def metrics(here: ContextDep) -> Response:
    """The counters, in Prometheus' text form."""
    here.metrics.waiting.set(here.workers.waiting)
    return Response(generate_latest(here.metrics.registry), media_type=CONTENT_TYPE_LATEST)
