"""Taking measurements into a session: load the state, step, save, in one transaction.

The number of an epoch (or sweep) is its idempotency key. What the log has already is
compared: the same again changes nothing and is answered as before, a different body is a
conflict. What is new must follow without a gap.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import structlog

from estimator.errors import FileFormatError, InputError
from estimator.measurements import GaussianVrp
from service.errors import BusyError, ConflictError, TooLargeError
from service.messages.documents import sweep_text
from service.session.entries import EpochEntry
from service.session.fold import ForgottenError, Job, NotPromptError, digest
from service.storage.folded import Folded
from service.storage.store import RevisionError, Step, Store

__all__ = ["Folder", "Taken", "new_session_id", "take_epochs", "take_sweep"]

_ATTEMPTS = 20
_REBUILT_AT_ONCE = 200  # epochs folded in one piece of work, so that each stays within a worker's limits


class Folder(Protocol):
    """What folds jobs: :class:`service.session.worker.Worker`, or any stand-in."""

    def fold(self, job: Job) -> Folded:
        """Fold a job."""
        ...


@dataclass(frozen=True)
class Taken:
    """What became of a request with measurements.

    Parameters
    ----------
    first, last : int
        Numbers of the request's first and last entry.
    new : int
        How many of them were new.
    state : str or None
        The estimate after the last, JSON, if it was computed just now.
    walls : int or None
        How many walls stand in it.
    processor_s : float or None
        Processor time that the new epochs took, seconds.
    """

    first: int
    last: int
    new: int
    state: str | None = None
    walls: int | None = None
    processor_s: float | None = None


def new_session_id() -> str:
    """A name that no one can guess and that ascends with time: 48 bits of milliseconds, 80 random."""
    return (time.time_ns() // 1_000_000).to_bytes(6, "big").hex() + os.urandom(10).hex()


def take_epochs(
    store: Store,
    pool: Folder,
    session_id: str,
    key_id: str | None,
    epochs: Sequence[EpochEntry],
    prompt_s: float | None = None,
) -> Taken:
    """Take epochs into a session; when this returns they are on disk.

    Parameters
    ----------
    store, pool
        Where sessions are kept, and who steps them.
    session_id, key_id : str
        The session, and the key it must belong to.
    epochs : sequence of EpochEntry
        Consecutive epochs, anchors in the session's order.
    prompt_s : float, optional
        Processor time after which the work is given up, to be done where it keeps nobody waiting.

    Raises
    ------
    NotFoundError
        If there is no such session.
    ConflictError
        If an epoch is known with another body, comes too early, or steps back in time.
    InputError
        If the engine cannot take it.
    BusyError
        If too much is going on.
    NotPromptError
        If it takes longer than ``prompt_s``.
    """
    entries = [(epoch.number, epoch.body) for epoch in epochs]
    _consecutive("epoch", [number for number, _ in entries])
    first, last = entries[0][0], entries[-1][0]
    for _ in range(_ATTEMPTS):
        try:
            with store.stepping(session_id, key_id) as step:
                new = _new_entries(step, "epoch", entries, step.row.next_epoch)
                state = walls = spent_s = None
                if new:
                    known_time = step.row.time_s
                    for epoch in epochs[-len(new) :]:
                        _later(epoch, known_time)
                        known_time = epoch.time_s
                    folded = _advance(step, pool, tuple(body for _, body in new), prompt_s)
                    step.commit("epoch", new, folded, epochs[-1].time_s)
                    state, walls = (folded.estimates[-1][name] for name in ("document", "walls"))
                    spent_s = folded.processor_s
                return Taken(first, last, len(new), state, walls, spent_s)
        except RevisionError:
            continue
    raise BusyError("expected a free moment of the session, other requests keep changing it")


def take_sweep(
    store: Store,
    session_id: str,
    key_id: str | None,
    number: int,
    walls: Sequence[GaussianVrp],
    max_walls: int,
) -> Taken:
    """Take a sweep's walls into a session that has no epoch yet; when this returns they are on disk.

    Raises
    ------
    NotFoundError
        If there is no such session.
    ConflictError
        If the sweep is known with other walls, comes too early, or epochs have been taken in.
    TooLargeError
        If the session would have more than ``max_walls`` walls.
    """
    entry = (number, sweep_text(number, walls))
    for _ in range(_ATTEMPTS):
        try:
            with store.stepping(session_id, key_id) as step:
                new = _new_entries(step, "sweep", [entry], step.row.next_sweep)
                if new:
                    if step.row.next_epoch > 0:
                        raise ConflictError(
                            f"sweep {number}: expected all sweeps before epoch 0, the session is at epoch "
                            f"{step.row.next_epoch}; its map stands on the walls sensed at the start",
                            {"next_epoch": step.row.next_epoch},
                        )
                    before = step.known("sweep", 0, step.row.next_sweep)
                    count = len(walls) + sum(len(json.loads(body)["walls"]) for body in before.values())
                    if count > max_walls:
                        raise TooLargeError(f"walls: expected at most {max_walls} in a session, got {count}")
                    step.commit("sweep", new)
                return Taken(number, number, len(new))
        except RevisionError:
            continue
    raise BusyError("expected a free moment of the session, other requests keep changing it")


def _advance(step: Step, pool: Folder, epochs: tuple[str, ...], prompt_s: float | None) -> Folded:
    """Fold new epochs on top of the snapshot; a damaged snapshot is computed anew from the log."""
    row = step.row
    if row.next_epoch == 0:
        return pool.fold(Job(row.id, row.config, _sweeps(step), None, epochs, prompt_s=prompt_s))
    known = step.digest()
    if known is not None:
        try:
            return pool.fold(Job(row.id, row.config, (), None, epochs, known, prompt_s))
        except ForgottenError:
            pass  # the worker is new, or has had too many other sessions
    kept = step.snapshot()
    if kept is not None and digest(kept[0]) == kept[1]:
        try:
            return pool.fold(Job(row.id, row.config, (), kept[0], epochs, None, prompt_s))
        except FileFormatError as error:
            reason = str(error)
    else:
        reason = "missing" if kept is None else "its digest differs"
    if prompt_s is not None and row.next_epoch > _REBUILT_AT_ONCE:
        raise NotPromptError
    structlog.get_logger().warning("snapshot damaged, rebuilt from the log", session=row.id, reason=reason)
    return pool.fold(Job(row.id, row.config, (), _rebuilt(step, pool), epochs))


def _rebuilt(step: Step, pool: Folder) -> bytes:
    """The state after the last epoch, folded from the log piece by piece."""
    row, snapshot = step.row, None
    past = tuple(step.known("epoch", 0, row.next_epoch - 1).values())
    for first in range(0, len(past), _REBUILT_AT_ONCE):
        part = past[first : first + _REBUILT_AT_ONCE]
        snapshot = pool.fold(Job(row.id, row.config, _sweeps(step), snapshot, part)).snapshot
    assert snapshot is not None
    return snapshot


def _sweeps(step: Step) -> tuple[str, ...]:
    return tuple(step.known("sweep", 0, step.row.next_sweep).values())


def _consecutive(kind: str, numbers: list[int]) -> None:
    if not numbers:
        raise InputError(f"{kind}s: expected at least one, got none")
    for before, after in pairwise(numbers):
        if after != before + 1:
            raise ConflictError(
                f"{kind} {after}: expected {before + 1} after {before}", {f"next_{kind}": before + 1}
            )


def _new_entries(
    step: Step, kind: str, entries: list[tuple[int, str]], expected: int
) -> list[tuple[int, str]]:
    """The entries that the log does not have; those that it has must be the same."""
    first, last = entries[0][0], entries[-1][0]
    if first > expected:
        raise ConflictError(
            f"{kind} {first}: expected {kind} {expected} next; nothing was taken in",
            {f"next_{kind}": expected},
        )
    known = step.known(kind, first, last) if first < expected else {}
    for number, body in entries:
        if number in known and known[number] != body:
            raise ConflictError(
                f"{kind} {number}: expected what was sent before, got another body; nothing was taken in. "
                f"The session expects {kind} {expected} next",
                {f"next_{kind}": expected},
            )
    return [entry for entry in entries if entry[0] >= expected]


def _later(epoch: EpochEntry, known_time_s: Any) -> None:
    if known_time_s is not None and not epoch.time_s > known_time_s:
        raise ConflictError(
            f"epoch {epoch.number}: expected a time after {known_time_s} s, got {epoch.time_s} s; "
            "nothing was taken in",
            {"next_epoch": epoch.number, "time_after_s": known_time_s},
        )
