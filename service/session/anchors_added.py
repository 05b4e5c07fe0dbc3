"""Anchors added to a session that has epochs: its run is computed anew, as if they had been there, unheard.

The log keeps saying what was measured, with nothing of the new anchors, so that an epoch that is sent again
is still known; state and estimates are the fold of it, as ever.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from service.errors import BusyError, TooLargeError
from service.messages.documents import dump
from service.session.fold import Job
from service.session.sessions import Folder
from service.storage.folded import Folded
from service.storage.rewrites import Rewrite
from service.storage.store import RevisionError, Step, Store

__all__ = ["add_anchors"]

_ATTEMPTS = 3
_AT_ONCE = 200  # epochs folded in one piece of work, so that each stays within a worker's limits
_UNHEARD: dict[str, list[float]] = {"delay_s": [], "delay_std_s": []}


def add_anchors(
    store: Store,
    pool: Folder,
    session_id: str,
    key_id: str | None,
    changed: Callable[[Mapping[str, Any]], dict[str, Any]],
    most_epochs: int,
) -> None:
    """Change a session's configuration and compute its run anew; when this returns all of it is on disk.

    Parameters
    ----------
    store, pool
        Where sessions are kept, and who steps them.
    session_id, key_id : str
        The session, and the key it must belong to.
    changed : callable
        The new configuration from the old, the anchors of before first; may raise.
    most_epochs : int
        Longest run that is computed anew.

    Raises
    ------
    NotFoundError
        If there is no such session.
    TooLargeError
        If the run is longer.
    InputError
        If the engine cannot take it with these anchors.
    BusyError
        If epochs keep coming meanwhile.
    """
    for _ in range(_ATTEMPTS):
        try:
            with store.stepping(session_id, key_id) as step:
                count = step.row.next_epoch
                if count > most_epochs:
                    raise TooLargeError(
                        f"expected at most {most_epochs} epochs in a session to add anchors to, got {count}"
                    )
                before = json.loads(step.row.config)
                config = changed(before)
                more = len(config["anchors"]) - len(before["anchors"])
                _compute(step, pool, dump(config), more)
                return
        except RevisionError:
            continue
    raise BusyError("expected a session that no epochs come to while its run is computed anew")


def _compute(step: Step, pool: Folder, config: str, more: int) -> None:
    row = step.row
    sweeps = tuple(step.known("sweep", 0, row.next_sweep).values())
    epochs = [(number, _widened(body, more)) for number, body in _log(step)]
    if not epochs:
        raise RevisionError  # the last was not there yet when this began
    folded: Folded | None = None
    rows: list[dict[str, Any]] = []
    for first in range(0, len(epochs), _AT_ONCE):
        part = tuple(body for _, body in epochs[first : first + _AT_ONCE])
        snapshot = None if folded is None else folded.snapshot
        folded = pool.fold(Job(row.id, config, sweeps, snapshot, part))
        rows.extend(folded.estimates)
    assert folded is not None
    last = folded.snapshot, folded.sha256, folded.integrity
    step.rewrite(Rewrite(row.id, row.revision, config, epochs, rows, *last))


def _log(step: Step) -> Sequence[tuple[int, str]]:
    return tuple(step.known("epoch", 0, step.row.next_epoch - 1).items())


def _widened(body: str, more: int) -> str:
    """An epoch of the log with so many more anchors, unheard; who said whom they asked did not ask these."""
    epoch = json.loads(body)
    epoch["paths"] += [dict(_UNHEARD) for _ in range(more)]
    if "asked" in epoch:
        epoch["asked"] += [False] * more
    return dump(epoch)
