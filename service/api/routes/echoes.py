"""Raw beam sweeps: ``POST .../sweeps`` for bodies of type ``application/octet-stream``."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from fastapi.routing import APIRoute
from starlette.routing import Match

from estimator.arrays import BeamSet
from service.api.context import ContextDep, SessionDep
from service.api.files_in import unpacked
from service.api.routes.measurements import take_walls
from service.session.beam_sweeps import EchoModel, EchoTask

__all__ = ["router"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["measurements"])
_BINARY = b"application/octet-stream"


class BinaryRoute(APIRoute):
    """A route for binary bodies alone; others at the same path take the rest."""

    def matches(self, scope: Any) -> tuple[Match, Any]:
        """Whether the route serves a request."""
        match, child = super().matches(scope)
        kind = dict(scope["headers"]).get(b"content-type", b"").partition(b";")[0].strip().lower()
        return (match, child) if kind == _BINARY else (Match.NONE, {})


async def raw_sweep(
    request: Request,
    session: SessionDep,
    here: ContextDep,
    response: Response,
    noise_variance: Annotated[float, Query(gt=0.0, le=1e6, allow_inf_nan=False)],
    sweep: Annotated[int, Query(ge=0, le=2**31 - 2)] = 0,
    panels: Annotated[int, Query(ge=1, le=64)] = 4,
    elements: Annotated[int, Query(ge=1, le=1024)] = 16,
    beams: Annotated[int, Query(ge=1, le=1024)] = 64,
    spacing_wavelengths: Annotated[float, Query(gt=0.0, le=10.0, allow_inf_nan=False)] = 0.5,
    heading_rad: Annotated[float, Query(ge=-1e9, le=1e9, allow_inf_nan=False)] = 0.0,
    model: EchoModel = "flash",
) -> dict[str, int]:
    """Find the walls in a raw beam sweep and take them in."""
    config = json.loads((await here.run(here.store.session, session.id, session.key_id)).config)
    task = EchoTask(
        await request.body(),
        config["carrier_hz"],
        noise_variance,
        BeamSet(panels, elements, beams, spacing_wavelengths, heading_rad),
        model,
        here.settings.max_unpacked_bytes,
    )
    walls = await unpacked(here, session, task)
    return await take_walls(here, session, sweep, list(walls), response)


router.add_api_route(
    "/sweeps",
    raw_sweep,
    methods=["POST"],
    route_class_override=BinaryRoute,
    include_in_schema=False,
)
