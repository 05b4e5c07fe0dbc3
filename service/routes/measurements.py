"""Measurements in: sweeps and epochs of paths."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter, Response

from estimator.measurements import Epoch, GaussianVrp
from service.beam_sweeps import PointsTask
from service.context import Context, ContextDep, SessionAccess, SessionDep
from service.epoch_schemas import EpochsRequest
from service.errors import TooLargeError
from service.schemas import SweepRequest
from service.sessions import Taken, take_epochs, take_sweep
from service.settings import Settings

__all__ = ["BINARY_SWEEP", "answer", "router", "take", "take_walls"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["measurements"])

# Of the other route at this path, :mod:`service.routes.echoes`, which takes bodies of another type.
_ECHO_QUERY: dict[str, dict[str, object]] = {
    "sweep": {"type": "integer", "minimum": 0, "maximum": 2**31 - 2, "default": 0},
    "noise_variance": {"type": "number", "exclusiveMinimum": 0, "maximum": 1e6},
    "panels": {"type": "integer", "minimum": 1, "maximum": 64, "default": 4},
    "elements": {"type": "integer", "minimum": 1, "maximum": 1024, "default": 16},
    "beams": {"type": "integer", "minimum": 1, "maximum": 1024, "default": 64},
    "spacing_wavelengths": {"type": "number", "exclusiveMinimum": 0, "maximum": 10, "default": 0.5},
    "heading_rad": {"type": "number", "minimum": -1e9, "maximum": 1e9, "default": 0},
    "model": {"type": "string", "enum": ["flash", "beams"], "default": "flash"},
}
BINARY_SWEEP = {
    "requestBody": {
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    },
    "parameters": [
        {
            "name": name,
            "in": "query",
            "required": False,
            "schema": schema,
            "description": "Of a raw beam sweep.",
        }
        for name, schema in _ECHO_QUERY.items()
    ],
}


@router.post("/sweeps", summary="Add walls sensed at the start", openapi_extra=BINARY_SWEEP)
async def sweeps(
    request: SweepRequest, session: SessionDep, here: ContextDep, response: Response
) -> dict[str, int]:
    """Walls, flashes or reflection points of one sweep of active sensing; all sweeps come before epoch 0.

    The same sweep again changes nothing; another body under its number is a conflict. A body of
    type `application/octet-stream` is a raw beam sweep, netCDF or npz with `echo_re`, `echo_im` (sweep,
    beam, tone), `tone_offset_hz` and `sweep_epoch`, as `hapslam trace` writes its echo shards: the walls
    in its first sweep are found.
    """
    walls = request.gaussians()
    if request.points:
        rows = [(point.range_m, point.range_std_m, point.azimuth_rad) for point in request.points]
        await here.run(here.store.session, session.id, session.key_id)
        walls += await here.run(here.pool.run, session.id, PointsTask(*zip(*rows, strict=True)))
    return await take_walls(here, session, request.sweep, walls, response)


async def take_walls(
    here: Context, session: SessionAccess, number: int, walls: list[GaussianVrp], response: Response
) -> dict[str, int]:
    """Take in a sweep's walls, and the answer."""
    limit = here.settings.max_walls
    taken = await here.run(take_sweep, here.store, session.id, session.key_id, number, walls, limit)
    response.headers["X-New-Entries"] = str(taken.new)
    return {"sweep": number, "walls": len(walls)}


@router.post("/epochs", summary="Add epochs of paths", response_class=Response)
async def epochs(request: EpochsRequest, session: SessionDep, here: ContextDep) -> Response:
    """Take in one or many consecutive epochs and answer with the state after the last.

    When the answer comes they are on disk. The same epochs again change nothing and are
    answered alike; another body under a known number, a gap, or a step back is a conflict
    that says what is expected next. All or none of a request is taken in.
    """
    if len(request.epochs) > here.settings.max_epochs_per_request:
        raise TooLargeError(
            f"epochs: expected at most {here.settings.max_epochs_per_request} in a request, "
            f"got {len(request.epochs)}"
        )
    return answer(here, session, *await here.run(_take, here, session, request))


def answer(here: Context, session: SessionAccess, taken: Taken, state: str) -> Response:
    """The answer to epochs that were taken in; wakes those who follow the session."""
    here.bell.ring(session.id)
    here.metrics.epochs.inc(taken.new)
    body = f'{{"first_epoch":{taken.first},"last_epoch":{taken.last},"state":{state}}}'
    return Response(body, media_type="application/json", headers={"X-New-Entries": str(taken.new)})


def _take(here: Context, session: SessionAccess, request: EpochsRequest) -> tuple[Taken, str]:
    names = here.anchors(session)
    epochs = [entry.estimator_epoch(names) for entry in request.epochs]
    return take(here, session, epochs)


def take(here: Context, session: SessionAccess, epochs: Sequence[Epoch]) -> tuple[Taken, str]:
    """Take in epochs; what was taken, and the state after the last of them."""
    _check_sizes(here.settings, epochs)
    taken = take_epochs(here.store, here.pool, session.id, session.key_id, epochs)
    if taken.state is not None:
        return taken, taken.state
    with here.store.reading() as connection:
        return taken, here.store.estimate(session.id, taken.last, connection) or "null"


def _check_sizes(settings: Settings, epochs: Sequence[Epoch]) -> None:
    for epoch in epochs:
        most = max(len(paths) for paths in epoch.paths)
        if most > settings.max_paths_per_anchor:
            raise TooLargeError(
                f"epoch {epoch.index}: expected at most {settings.max_paths_per_anchor} paths of an anchor, "
                f"got {most}"
            )
