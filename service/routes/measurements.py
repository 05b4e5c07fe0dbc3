"""Measurements in: sweeps and epochs of paths."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter, Response

from estimator.measurements import Epoch
from service.context import Context, ContextDep, SessionAccess, SessionDep
from service.epoch_schemas import EpochsRequest
from service.errors import TooLargeError
from service.schemas import SweepRequest
from service.sessions import Taken, take_epochs, take_sweep
from service.settings import Settings

__all__ = ["answer", "router", "take"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["measurements"])


@router.post("/sweeps", summary="Add walls sensed at the start")
async def sweeps(
    request: SweepRequest, session: SessionDep, here: ContextDep, response: Response
) -> dict[str, int]:
    """Walls or flashes of one sweep of active sensing; all sweeps come before epoch 0.

    The same sweep again changes nothing; another body under its number is a conflict.
    """
    walls = request.gaussians()
    limit = here.settings.max_walls
    taken = await here.run(take_sweep, here.store, session.id, session.key_id, request.sweep, walls, limit)
    response.headers["X-New-Entries"] = str(taken.new)
    return {"sweep": request.sweep, "walls": len(walls)}


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
