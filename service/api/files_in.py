"""Files taken in, for a request that waits and for a job that does not: one way for both."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, TypeVar

from estimator.errors import FileFormatError
from service.api.context import Context, SessionAccess
from service.api.routes.measurements import limits, take_walls, taken_in
from service.api.routes.sessions import Once, create_session
from service.errors import ConflictError, WorkerDiedError
from service.messages.channels import ChannelsQuery
from service.messages.session_requests import SessionRequest
from service.session.files import FileTask, Unpacked
from service.session.raw_channels import ChannelsTask
from service.session.sessions import Taken
from service.session.tasks import Task
from service.session.workers import Lane

__all__ = ["take_channels", "take_dataset", "take_upload", "unpacked"]

T = TypeVar("T")
Answer = tuple[Taken, str]


async def unpacked(here: Context, session: SessionAccess, task: Task[T]) -> T:
    """What a file holds, read by a worker."""
    try:
        return await here.work(Lane.BULK, session, task)
    except WorkerDiedError as error:
        raise FileFormatError("file: expected one that can be read, its reader crashed over it") from error


async def take_channels(here: Context, session: SessionAccess, body: bytes, radio: ChannelsQuery) -> Answer:
    """Estimate the paths in raw channels and take them in: what was taken, and the state."""
    config = json.loads((await here.run(here.store.session, session.id, session.key_id)).config)
    task = ChannelsTask(
        body,
        tuple(config["anchors"]),
        config["carrier_hz"],
        radio.noise_variance,
        radio.array(),
        radio.orientation == "fixed",
        here.settings.max_unpacked_bytes,
        limits(here),
    )
    return await taken_in(here, session, await unpacked(here, session, task))


async def take_dataset(here: Context, session: SessionAccess, body: bytes) -> Answer:
    """Take a measurement file or a zipped dataset into a session: what was taken, and the state."""
    await here.run(here.store.session, session.id, session.key_id)
    task = FileTask(body, here.settings.max_unpacked_bytes, limits(here))
    return await _take_all(here, session, await unpacked(here, session, task))


async def take_upload(
    here: Context, key_id: str | None, body: bytes, stated: Mapping[str, Any], once: Once
) -> SessionAccess:
    """Make a session for a measurement file or a zipped dataset and take all of it in.

    Parameters
    ----------
    here : Context
        What the routes share.
    key_id : str or None
        Whose session it is.
    body : bytes
        The file.
    stated : mapping
        What the file does not say of the session: ``name``, ``method``, ``engine``, ``seed``.
    once : tuple or None
        See :meth:`service.storage.store.Store.create`.
    """
    task = FileTask(body, here.settings.max_unpacked_bytes, limits(here))
    found = await unpacked(here, SessionAccess("", key_id), task)
    try:
        wanted = SessionRequest.model_validate({**found.session, **stated})
    except ValueError as error:
        raise FileFormatError(f"file: expected measurements that make a session: {error}") from error
    session, new = await create_session(wanted, here, key_id, once)
    try:
        if found.epochs:
            await _take_all(here, session, found)
    except Exception:
        if new:
            await here.run(here.store.delete, session.id, session.key_id)
        raise
    return session


async def _take_all(here: Context, session: SessionAccess, found: Unpacked) -> Answer:
    """Take a file's walls and epochs into a session whose anchors they name."""
    from fastapi import Response

    row = await here.run(here.store.session, session.id, session.key_id)
    config = json.loads(row.config)
    for what in ("anchors", "carrier_hz"):
        if config[what] != found.session[what]:
            raise ConflictError(
                f"{what}: expected those of the session, {config[what]}, got {found.session[what]}"
            )
    if not found.epochs:
        raise FileFormatError("file: expected at least one epoch, got none")
    await take_walls(here, session, 0, list(found.walls), Response())
    if found.truth is not None:
        await here.run(here.store.set_truth, session.id, session.key_id, found.truth)
    return await taken_in(here, session, found.epochs)
