"""State out: the estimates at any epoch, the trajectory, the map, and files of everything."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Query, Response
from sqlalchemy import Connection, Row

from service.context import Context, ContextDep, SessionAccess, SessionDep
from service.errors import TooLargeError
from service.results import (
    latest_epoch,
    map_document,
    measurements_file,
    picture,
    result_file,
    session_result,
)
from service.smoothing import SmoothTask

__all__ = ["router"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["state"])
T = TypeVar("T")

EpochQuery = Annotated[
    int | None, Query(ge=0, le=2**31 - 2, description="Epoch to look at; by default the latest.")
]
_COLUMNS = (
    "epoch",
    "time_s",
    "x_m",
    "y_m",
    "variance_x_m2",
    "covariance_xy_m2",
    "variance_y_m2",
    "rotation_std_rad",
    "hypotheses",
    "walls",
)


@router.get("/state", summary="Estimates at an epoch", response_class=Response)
async def state(session: SessionDep, here: ContextDep, epoch: EpochQuery = None) -> Response:
    """Agent, anchors and walls with covariances, in the estimator's frame."""

    def look(row: Row[Any], connection: Connection) -> str:
        return here.store.estimate(row.id, latest_epoch(row, epoch), connection) or "null"

    return Response(await _looked(here, session, look), media_type="application/json")


@router.get("/trajectory", summary="The agent's track")
async def trajectory(
    session: SessionDep,
    here: ContextDep,
    first: Annotated[int, Query(ge=0, le=2**31 - 2)] = 0,
    limit: Annotated[int, Query(ge=1, le=100_000)] = 100_000,
) -> dict[str, list[Any]]:
    """Positions with covariances epoch by epoch, as columns of equal length."""

    def look(row: Row[Any], connection: Connection) -> dict[str, list[Any]]:
        rows = list(here.store.estimates(row.id, first, 2**31 - 1, connection, limit))
        return {name: [getattr(found, name) for found in rows] for name in _COLUMNS}

    return await _looked(here, session, look)


@router.get("/smoothed", summary="Track and map given all measurements", response_class=Response)
async def smoothed(
    session: SessionDep,
    here: ContextDep,
    lag: Annotated[int, Query(ge=0, le=1000, description="Epochs to look ahead; 0 for the whole run.")] = 0,
) -> Response:
    """The run smoothed: every epoch's agent, and the map, given all measurements, with marginal covariances.

    The track as columns in the estimator's frame, the map as `map` gives it. It is computed at each
    request, from what the session's engine found.
    """

    def look(row: Row[Any], connection: Connection) -> SmoothTask:
        latest_epoch(row, None)
        limit = here.settings.max_smoothed_epochs
        if row.next_epoch > limit:
            raise TooLargeError(
                f"expected a session of at most {limit} epochs to smooth, it has {row.next_epoch}"
            )
        sweeps, epochs = (tuple(here.store.log(row.id, kind, connection)) for kind in ("sweep", "epoch"))
        return SmoothTask(row.config, sweeps, epochs, session_result(here.store, row, connection), lag)

    task = await _looked(here, session, look)
    return Response(await here.run(here.pool.run, session.id, task), media_type="application/json")


@router.get("/map", summary="The map")
async def map_(
    session: SessionDep,
    here: ContextDep,
    epoch: EpochQuery = None,
    format: Annotated[str, Query(pattern="^(json|geojson)$")] = "json",
) -> dict[str, Any]:
    """Walls as the segments on which reflections were seen, anchors, agent and track.

    In the frame of the floor plan if the session states its start frame. GeoJSON
    coordinates are metres of that local frame, not degrees.
    """
    document = await _looked(here, session, lambda row, connection: _map(here, row, connection, epoch))
    return _geojson(document) if format == "geojson" else document


@router.get("/map.svg", summary="The map as SVG", response_class=Response)
async def map_svg(session: SessionDep, here: ContextDep, epoch: EpochQuery = None) -> Response:
    """The map as a picture."""
    return await _picture(here, session, epoch, "svg", "image/svg+xml")


@router.get("/map.png", summary="The map as PNG", response_class=Response)
async def map_png(session: SessionDep, here: ContextDep, epoch: EpochQuery = None) -> Response:
    """The map as a picture."""
    return await _picture(here, session, epoch, "png", "image/png")


@router.get("/export", summary="All estimates as a result file", response_class=Response)
async def export(session: SessionDep, here: ContextDep) -> Response:
    """All estimates with covariances as netCDF: what ``hapslam evaluate`` and ``hapslam plot`` read."""

    def look(row: Row[Any], connection: Connection) -> bytes:
        latest_epoch(row, None)
        return result_file(session_result(here.store, row, connection))

    return _file(await _looked(here, session, look), f"{session.id}-result.nc")


@router.get("/measurements", summary="All measurements as a file", response_class=Response)
async def measurements(session: SessionDep, here: ContextDep) -> Response:
    """The measurement log as netCDF: what ``hapslam slam`` and ``hapslam push`` read."""
    content = await _looked(
        here, session, lambda row, connection: measurements_file(here.store, row, connection)
    )
    return _file(content, f"{session.id}-measurements.nc")


async def _looked(here: Context, session: SessionAccess, look: Callable[[Row[Any], Connection], T]) -> T:
    """What ``look`` finds of a session, in one consistent read."""

    def run() -> T:
        with here.store.reading() as connection:
            return look(here.store.session(session.id, session.key_id, connection), connection)

    return await here.run(run)


def _map(here: Context, row: Row[Any], connection: Connection, epoch: int | None) -> dict[str, Any]:
    result = session_result(here.store, row, connection, latest_epoch(row, epoch))
    return map_document(result, json.loads(row.config)["start_frame"])


async def _picture(
    here: Context, session: SessionAccess, epoch: int | None, suffix: str, media_type: str
) -> Response:
    def look(row: Row[Any], connection: Connection) -> bytes:
        last = latest_epoch(row, epoch)
        return picture(session_result(here.store, row, connection, last), row.name, suffix)

    return Response(await _looked(here, session, look), media_type=media_type)


def _file(content: bytes, name: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type="application/x-netcdf", headers=headers)


def _geojson(document: dict[str, Any]) -> dict[str, Any]:
    features = [
        _feature("LineString", wall["segment_m"], kind="wall", id=wall["id"], vrp_m=wall["vrp_m"])
        for wall in document["walls"]
    ]
    features += [
        _feature(
            "Point",
            anchor["position_m"],
            kind="anchor",
            name=anchor["name"],
            covariance_m2=anchor["covariance_m2"],
        )
        for anchor in document["anchors"]
        if anchor["located"]
    ]
    agent = document["agent"]
    features.append(
        _feature("Point", agent["position_m"], kind="agent", covariance_m2=agent["covariance_m2"])
    )
    if len(document["track_m"]) > 1:
        features.append(_feature("LineString", document["track_m"], kind="track"))
    return {
        "type": "FeatureCollection",
        "frame": document["frame"],
        "epoch": document["epoch"],
        "time_s": document["time_s"],
        "features": features,
    }


def _feature(kind_of_geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": kind_of_geometry, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}
