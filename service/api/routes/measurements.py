"""Measurements in: sweeps and epochs of paths."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from fastapi import APIRouter, Request, Response

from estimator.measurements import GaussianVrp
from service.api.context import Context, ContextDep, SessionAccess, SessionDep
from service.api.openapi import described
from service.errors import TooLargeError
from service.messages.answers import EpochsAnswer, SweepAnswer
from service.messages.epochs import EpochsRequest
from service.messages.sweeps import SweepRequest
from service.session.beam_sweeps import PointsTask
from service.session.bodies import EpochsTask, ParseTask, json_content
from service.session.entries import EpochEntry, EpochLimits, settled
from service.session.fold import NotPromptError
from service.session.sessions import Taken, take_epochs, take_sweep
from service.session.workers import AnyWorker, Lane

__all__ = ["answered", "limits", "router", "take", "take_walls", "taken_in"]

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["measurements"])

# Of the other route at this path, :mod:`service.api.routes.echoes`, which takes bodies of another type.
_ECHO_QUERY: dict[str, dict[str, object]] = {
    "sweep": {"type": "integer", "minimum": 0, "maximum": 2**31 - 2},
    "noise_variance": {"type": "number", "exclusiveMinimum": 0, "maximum": 1e6},
    "panels": {"type": "integer", "minimum": 1, "maximum": 64},
    "elements": {"type": "integer", "minimum": 1, "maximum": 1024},
    "beams": {"type": "integer", "minimum": 1, "maximum": 1024},
    "spacing_wavelengths": {"type": "number", "exclusiveMinimum": 0, "maximum": 10},
    "heading_rad": {"type": "number", "minimum": -1e9, "maximum": 1e9},
    "model": {"type": "string", "enum": ["flash", "beams"]},
}
_SWEEP = {
    **json_content(SweepRequest, binary=True),
    "parameters": [
        {
            "name": name,
            "in": "query",
            "required": False,
            "schema": schema,
            "description": "Of a raw beam sweep alone.",
        }
        for name, schema in _ECHO_QUERY.items()
    ],
}


@router.post(
    "/sweeps", summary="Add walls sensed at the start", openapi_extra=_SWEEP, responses=described(SweepAnswer)
)
async def sweeps(
    request: Request, session: SessionDep, here: ContextDep, response: Response
) -> dict[str, int]:
    """Walls, flashes or reflection points of one sweep of active sensing; all sweeps come before epoch 0.

    The same sweep again changes nothing; another body under its number is a conflict. A body of
    type `application/octet-stream` is a raw beam sweep, netCDF or npz with `echo_re`, `echo_im` (sweep,
    beam, tone), `tone_offset_hz` and `sweep_epoch`, as `hapslam trace` writes its echo shards: the walls
    in its first sweep are found.
    """
    body = await request.body()
    found = await here.parsed(session, body, ParseTask(SweepRequest, body))
    count, most = len(found.walls) + len(found.flashes), here.settings.max_walls
    if count > most:
        raise TooLargeError(f"walls: expected at most {most} in a session, got {count}")
    walls = found.gaussians()
    if found.points:
        rows = [(point.range_m, point.range_std_m, point.azimuth_rad) for point in found.points]
        await here.run(here.store.session, session.id, session.key_id)
        walls += await here.work(Lane.BULK, session, PointsTask(*zip(*rows, strict=True)))
    return await take_walls(here, session, found.sweep, walls, response)


async def take_walls(
    here: Context, session: SessionAccess, number: int, walls: list[GaussianVrp], response: Response
) -> dict[str, int]:
    """Take in a sweep's walls, and the answer."""
    limit = here.settings.max_walls
    taken = await here.run(take_sweep, here.store, session.id, session.key_id, number, walls, limit)
    here.note_walls(session, None)
    response.headers["X-New-Entries"] = str(taken.new)
    return {"sweep": number, "walls": len(walls)}


@router.post(
    "/epochs",
    summary="Add epochs of paths",
    response_class=Response,
    responses=described(EpochsAnswer),
    openapi_extra=json_content(EpochsRequest),
)
async def epochs(request: Request, session: SessionDep, here: ContextDep) -> Response:
    """Take in one or many consecutive epochs and answer with the state after the last.

    When the answer comes they are on disk. The same epochs again change nothing and are
    answered alike; another body under a known number, a gap, or a step back is a conflict
    that says what is expected next. All or none of a request is taken in.
    """
    body, terms = await request.body(), await here.terms(session)
    task = EpochsTask(body, terms, limits(here))
    return await take(here, session, await here.parsed(session, body, task))


def limits(here: Context) -> EpochLimits:
    """How much a request may bring."""
    given = here.settings
    return EpochLimits(given.max_epochs_per_request, given.max_paths_per_anchor, given.max_walls)


async def take(here: Context, session: SessionAccess, entries: Sequence[EpochEntry]) -> Response:
    """Take in epochs; the answer to them."""
    return answered(*await taken_in(here, session, entries))


def answered(taken: Taken, state: str) -> Response:
    """The answer to epochs that were taken in."""
    body = f'{{"first_epoch":{taken.first},"last_epoch":{taken.last},"state":{state}}}'
    return Response(body, media_type="application/json", headers={"X-New-Entries": str(taken.new)})


async def taken_in(here: Context, session: SessionAccess, entries: Sequence[EpochEntry]) -> tuple[Taken, str]:
    """Take in epochs: what was taken, and the state after the last. Wakes those who follow the session."""
    if any(entry.frame_time for entry in entries):
        before_s = await here.run(here.store.epoch_time, session.id, entries[0].number - 1)
        entries = settled(entries, before_s)
    pairs, prompt_s = await _pairs(here, session, entries), here.settings.prompt_s
    found = None
    if here.pace.expected_s(session.id, pairs) <= prompt_s:
        with suppress(NotPromptError):
            found = await _taken(here, session, entries, prompt_s)
    taken, state = found or await _taken(here, session, entries, None)
    if taken.processor_s is not None:
        here.pace.note(session.id, pairs, taken.processor_s)
    if taken.walls is not None:
        here.note_walls(session, taken.walls)
    here.bell.ring(session.id)
    here.metrics.epochs.inc(taken.new)
    return taken, state


async def _pairs(here: Context, session: SessionAccess, entries: Sequence[EpochEntry]) -> int:
    """Pairs of a path and a wall in all epochs; raises TooLargeError if one is too much for a step."""
    walls, most = await here.walls(session) + 1, here.settings.max_step_pairs
    for entry in entries:
        if entry.paths * walls > most:
            raise TooLargeError(
                f"epoch {entry.number}: expected at most {most} pairs of a path and a wall, got "
                f"{entry.paths} paths beside {walls - 1} walls; send the strongest paths"
            )
    return sum(entry.paths * walls for entry in entries)


async def _taken(
    here: Context, session: SessionAccess, entries: Sequence[EpochEntry], prompt_s: float | None
) -> tuple[Taken, str]:
    """Take in epochs, promptly or where it may take long: what was taken, and the state."""

    def work(worker: AnyWorker) -> tuple[Taken, str]:
        taken = take_epochs(here.store, worker, session.id, session.key_id, entries, prompt_s)
        state = taken.state
        if state is None:
            with here.store.reading() as connection:
                state = here.store.estimate(session.id, taken.last, connection) or "null"
        return taken, state

    lane = Lane.BULK if prompt_s is None else Lane.STEPS
    return await here.workers.hold(lane, session.key_id, session.id, work)
