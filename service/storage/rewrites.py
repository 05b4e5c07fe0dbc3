"""A session's log, state and estimates replaced at once, where its configuration changes what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection

from service.storage.tables import estimates, measurements, sessions, snapshots

__all__ = ["Rewrite", "rewrite"]


@dataclass(frozen=True)
class Rewrite:
    """What a session's epochs become.

    Parameters
    ----------
    session_id : str
        The session.
    revision : int
        Its revision when it was read: if it has moved on, nothing is written.
    config : str
        Its new configuration, JSON.
    epochs : sequence of (int, str)
        Numbers and bodies of its log.
    estimates : sequence of dict
        Rows of the table ``estimates``, without the session.
    snapshot, sha256 : bytes
        The state after the last epoch and its digest.
    integrity : str
        Whether the last epoch may be relied on.
    """

    session_id: str
    revision: int
    config: str
    epochs: Sequence[tuple[int, str]]
    estimates: Sequence[dict[str, Any]]
    snapshot: bytes
    sha256: bytes
    integrity: str


def rewrite(connection: Connection, new: Rewrite) -> bool:
    """Write in a transaction that is open; whether the session was still as it had been read."""
    named = sa.and_(sessions.c.id == new.session_id, sessions.c.revision == new.revision)
    moved = {
        "config": new.config,
        "revision": new.revision + 1,
        "updated_at": datetime.now(UTC),
        "integrity": new.integrity,
    }
    if connection.execute(sa.update(sessions).where(named).values(**moved)).rowcount != 1:
        return False
    of_log = sa.and_(
        measurements.c.session_id == new.session_id,
        measurements.c.kind == "epoch",
        measurements.c.number == sa.bindparam("at"),
    )
    bodies = [{"at": number, "text": body} for number, body in new.epochs]
    connection.execute(sa.update(measurements).where(of_log).values(body=sa.bindparam("text")), bodies)
    connection.execute(sa.delete(estimates).where(estimates.c.session_id == new.session_id))
    rows = [{"session_id": new.session_id, **row} for row in new.estimates]
    connection.execute(sa.insert(estimates), rows)
    kept = sa.update(snapshots).where(snapshots.c.session_id == new.session_id)
    connection.execute(kept.values(state=new.snapshot, sha256=new.sha256))
    return True
