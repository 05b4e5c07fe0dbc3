"""State out: the estimates at any epoch, the trajectory, the map, and files of everything."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from service.api.context import Context, ContextDep, SessionAccess, SessionDep
from service.api.openapi import described
from service.messages.answers import Coverage, Map, Smoothed, State, Track
from service.session.reads import (
    ExportFormat,
    ExportRead,
    MapFormat,
    MapRead,
    MeasurementsRead,
    PictureRead,
    SmoothRead,
    TrackRead,
)
from service.session.results import latest_epoch
from service.session.tasks import Task
from service.session.twins import CoverageRead, TwinRead
from service.session.workers import Lane

__all__ = ["router"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["state"])

EpochQuery = Annotated[
    int | None, Query(ge=0, le=2**31 - 2, description="Epoch to look at; by default the latest.")
]
_EXPORTS: dict[ExportFormat, tuple[str, str]] = {
    "netcdf": ("application/x-netcdf", "result.nc"),
    "mcap": ("application/octet-stream", "result.mcap"),
    "tum": ("text/plain", "track.txt"),
}
_TOML = "application/toml"
_JSON, _NETCDF = "application/json", "application/x-netcdf"


@router.get("/state", summary="Estimates at an epoch", response_class=Response, responses=described(State))
async def state(session: SessionDep, here: ContextDep, epoch: EpochQuery = None) -> Response:
    """Agent, anchors and walls with covariances, in the estimator's frame."""

    def look() -> str:
        with here.store.reading() as connection:
            row = here.store.session(session.id, session.key_id, connection)
            return here.store.estimate(row.id, latest_epoch(row, epoch), connection) or "null"

    return Response(await here.run(look), media_type=_JSON)


@router.get("/trajectory", summary="The agent's track", response_class=Response, responses=described(Track))
async def trajectory(
    session: SessionDep,
    here: ContextDep,
    first: Annotated[int, Query(ge=0, le=2**31 - 2)] = 0,
    limit: Annotated[int, Query(ge=1, le=100_000)] = 100_000,
) -> Response:
    """Positions with covariances epoch by epoch, as columns of equal length."""
    return await _read(here, session, TrackRead(session.id, session.key_id, first, limit), _JSON)


@router.get(
    "/smoothed",
    summary="Track and map given all measurements",
    response_class=Response,
    responses=described(Smoothed),
)
async def smoothed(
    session: SessionDep,
    here: ContextDep,
    lag: Annotated[int, Query(ge=0, le=1000, description="Epochs to look ahead; 0 for the whole run.")] = 0,
) -> Response:
    """The run smoothed: every epoch's agent, and the map, given all measurements, with marginal covariances.

    The track as columns in the estimator's frame, the map as `map` gives it. It is computed at each
    request, from what the session's engine found.
    """
    task = SmoothRead(session.id, session.key_id, lag, here.settings.max_smoothed_epochs)
    return await _read(here, session, task, _JSON)


HeightQuery = Annotated[
    float,
    Query(ge=0.1, le=100.0, description="Height of the agent over the floor, metres: nothing tells it."),
]
StepQuery = Annotated[float, Query(ge=0.05, le=100.0, description="Distance between points, metres.")]


@router.get(
    "/twin",
    summary="The map as a floor plan that predicts channels",
    response_class=Response,
    responses={200: {"content": {_TOML: {"schema": {"type": "string"}}}}},
)
async def twin(session: SessionDep, here: ContextDep, agent_height_m: HeightQuery = 1.5) -> Response:
    """The run smoothed and written down as a floor plan, with what is not known of it: see `hapslam twin`.

    In the estimator's frame. `hapslam predict` and `hapslam trace` take the file.
    """
    limit = here.settings.max_smoothed_epochs
    task = TwinRead(session.id, session.key_id, agent_height_m, limit)
    return _named(await _read(here, session, task, _TOML), f"{session.id}-twin.toml")


@router.get("/coverage", summary="Predicted coverage", response_class=Response, responses=described(Coverage))
async def coverage(
    session: SessionDep, here: ContextDep, step_m: StepQuery = 0.5, agent_height_m: HeightQuery = 1.5
) -> Response:
    """The gain of the strongest anchor that the twin predicts on a grid, in the estimator's frame."""
    return await _read(here, session, _coverage(here, session, step_m, agent_height_m, "json"), _JSON)


@router.get("/coverage.png", summary="Predicted coverage as PNG", response_class=Response)
async def coverage_png(
    session: SessionDep, here: ContextDep, step_m: StepQuery = 0.5, agent_height_m: HeightQuery = 1.5
) -> Response:
    """The same as a picture, with the twin's walls and anchors, and the track."""
    return await _read(here, session, _coverage(here, session, step_m, agent_height_m, "png"), "image/png")


@router.get("/map", summary="The map", response_class=Response, responses=described(Map))
async def map_(
    session: SessionDep,
    here: ContextDep,
    epoch: EpochQuery = None,
    format: Annotated[
        MapFormat, Query(description="`location` is `LocationData` of `Nlmf_Location` (3GPP TS 29.572).")
    ] = "json",
) -> Response:
    """Walls as the segments on which reflections were seen, anchors, agent and track.

    In the frame of the floor plan if the session states its start frame. Coordinates of GeoJSON and
    JSON-FG are metres of that local frame, not degrees.
    """
    last = await _epoch(here, session, epoch)
    return await _read(here, session, MapRead(session.id, session.key_id, last, format), _JSON)


@router.get("/map.svg", summary="The map as SVG", response_class=Response)
async def map_svg(session: SessionDep, here: ContextDep, epoch: EpochQuery = None) -> Response:
    """The map as a picture."""
    return await _picture(here, session, epoch, "svg", "image/svg+xml")


@router.get("/map.png", summary="The map as PNG", response_class=Response)
async def map_png(session: SessionDep, here: ContextDep, epoch: EpochQuery = None) -> Response:
    """The map as a picture."""
    return await _picture(here, session, epoch, "png", "image/png")


@router.get("/export", summary="All estimates as a result file", response_class=Response)
async def export(session: SessionDep, here: ContextDep, format: ExportFormat = "netcdf") -> Response:
    """All estimates as a file.

    `netcdf` has everything with covariances: what `hapslam evaluate` and `hapslam plot` read. `mcap` has
    poses with covariances and markers of the map as ROS 2 messages, for Foxglove and rosbag2. `tum` is the
    track as text, in the frame of the floor plan if the session states its start frame.
    """
    task = ExportRead(session.id, session.key_id, format)
    media_type, suffix = _EXPORTS[format]
    return _named(await _read(here, session, task, media_type), f"{session.id}-{suffix}")


@router.get("/measurements", summary="All measurements as a file", response_class=Response)
async def measurements(session: SessionDep, here: ContextDep) -> Response:
    """The measurement log as netCDF: what ``hapslam slam`` and ``hapslam push`` read."""
    task = MeasurementsRead(session.id, session.key_id)
    return _named(await _read(here, session, task, _NETCDF), f"{session.id}-measurements.nc")


def _coverage(
    here: Context, session: SessionAccess, step_m: float, agent_height_m: float, form: Literal["png", "json"]
) -> CoverageRead:
    limits = here.settings.max_smoothed_epochs, here.settings.max_coverage_points
    return CoverageRead(
        session.id, session.key_id, agent_height_m, limits[0], step_m, max_points=limits[1], form=form
    )


async def _read(here: Context, session: SessionAccess, task: Task[Any], media_type: str) -> Response:
    return Response(await here.work(Lane.READS, session, task), media_type=media_type)


async def _epoch(here: Context, session: SessionAccess, epoch: int | None) -> int:
    """The epoch asked for, or the latest; raises NotFoundError or ConflictError."""
    return latest_epoch(await here.run(here.store.session, session.id, session.key_id), epoch)


async def _picture(
    here: Context,
    session: SessionAccess,
    epoch: int | None,
    suffix: Literal["png", "svg"],
    media_type: str,
) -> Response:
    last = await _epoch(here, session, epoch)
    name = session.id, last, suffix
    content = here.pictures.get(name)
    if content is None:
        task: Task[bytes] = PictureRead(session.id, session.key_id, last, suffix)
        content = await here.work(Lane.READS, session, task)
        here.pictures.put(name, content)
    return Response(content, media_type=media_type)


def _named(response: Response, name: str) -> Response:
    response.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return response
