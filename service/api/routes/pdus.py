"""Encoded messages of positioning: ``POST .../pdus``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from service.api.context import ContextDep, SessionDep
from service.api.files_in import unpacked
from service.api.openapi import described
from service.api.routes.measurements import limits, take
from service.api.routes.uploads import FILE
from service.messages.answers import EpochsAnswer
from service.messages.asn1 import Protocol
from service.session.pdus import PduTask

__all__ = ["router"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["measurements"])


@router.post(
    "/pdus",
    summary="Add an epoch as an encoded message",
    response_class=Response,
    responses=described(EpochsAnswer),
    openapi_extra=FILE,
)
async def pdus(
    request: Request,
    session: SessionDep,
    here: ContextDep,
    protocol: Annotated[Protocol, Query(description="`lpp` is decoded as UPER, `nrppa` as APER.")],
    epoch: Annotated[int, Query(ge=0, le=2**31 - 2, description="Number of the epoch.")],
    time_s: Annotated[
        float | None,
        Query(ge=-1e9, le=1e9, allow_inf_nan=False, description="Instead of the time stamps' frame numbers."),
    ] = None,
) -> Response:
    """Take in one message as one epoch.

    It is an `LPP-Message` with `ProvideLocationInformation` (TS 37.355), or an `NRPPA-PDU` with a measurement
    response or report (TS 38.455). Its measurements are read as `epochs` reads their JSON. Multi-RTT
    needs both ends, so send these as JSON.
    """
    task = PduTask(protocol, await request.body(), epoch, time_s, await here.terms(session), limits(here))
    return await take(here, session, await unpacked(here, session, task))
