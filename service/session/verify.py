"""``hapslam service verify``: every session computed anew from its log, and compared bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import sqlalchemy as sa

from estimator.errors import HapslamError
from service.session.fold import Job, digest, fold
from service.storage.store import Store
from service.storage.tables import sessions, snapshots

__all__ = ["Finding", "verify"]


@dataclass(frozen=True)
class Finding:
    """What became of a session.

    Parameters
    ----------
    session_id : str
        The session.
    epochs : int
        Epochs in its log.
    differences : tuple of str
        What differs from the log's fold; empty if nothing.
    """

    session_id: str
    epochs: int
    differences: tuple[str, ...]


def verify(store: Store, progress: Callable[[int, int], None] | None = None) -> Iterator[Finding]:
    """Compare all sessions with the fold of their logs, one after the other.

    Sessions that take in measurements meanwhile are compared as they were at one instant.
    """
    with store.reading() as connection:
        ids = list(connection.execute(sa.select(sessions.c.id).order_by(sessions.c.id)).scalars())
    for done, session_id in enumerate(ids):
        finding = _compare(store, session_id)
        if finding is not None:
            yield finding
        if progress is not None:
            progress(done + 1, len(ids))


def _compare(store: Store, session_id: str) -> Finding | None:
    with store.reading() as connection:
        row = connection.execute(sa.select(sessions).where(sessions.c.id == session_id)).one_or_none()
        if row is None:  # deleted meanwhile
            return None
        sweeps, epochs = (tuple(store.log(session_id, kind, connection)) for kind in ("sweep", "epoch"))
        kept = connection.execute(
            sa.select(snapshots).where(snapshots.c.session_id == session_id)
        ).one_or_none()
        rows = list(store.estimates(session_id, 0, 2**31 - 1, connection))
        documents, packed = [row.document for row in rows], [row.packed for row in rows]
    differences = []
    if (len(sweeps), len(epochs)) != (row.next_sweep, row.next_epoch):
        differences.append(
            f"the log holds {len(sweeps)} sweeps and {len(epochs)} epochs, "
            f"the session expects {row.next_sweep} and {row.next_epoch} next"
        )
    if not epochs:
        if kept is not None or documents:
            differences.append("estimates without epochs")
        return Finding(session_id, 0, tuple(differences))
    try:
        folded = fold(Job(session_id, row.config, sweeps, None, epochs))
    except HapslamError as error:
        return Finding(session_id, len(epochs), (*differences, f"the log cannot be folded: {error}"))
    if kept is None or bytes(kept.state) != folded.snapshot or bytes(kept.sha256) != digest(folded.snapshot):
        differences.append("the snapshot differs")
    again = [estimate["document"] for estimate in folded.estimates]
    if any(old not in (None, made["packed"]) for old, made in zip(packed, folded.estimates, strict=False)):
        differences.append("the packed estimates differ")
    if again != documents:
        first = next(
            (i for i, pair in enumerate(zip(again, documents, strict=False)) if pair[0] != pair[1]),
            min(len(again), len(documents)),
        )
        differences.append(f"the estimates differ from epoch {first} on")
    return Finding(session_id, len(epochs), tuple(differences))
