"""Epochs on their way into the log: as text, with what is asked about them before they are stepped."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from estimator.measurements import Epoch
from service.errors import TooLargeError
from service.messages.documents import epoch_text, read_epoch
from service.messages.nr_reports import FRAME_PERIOD_S

__all__ = ["EpochEntry", "EpochLimits", "entries_of", "settled"]


@dataclass(frozen=True)
class EpochEntry:
    """An epoch as the log keeps it.

    Parameters
    ----------
    number : int
        Of the epoch.
    time_s : float
        Its time.
    body : str
        Its text in the log.
    paths : int
        Paths of all anchors together, and walls seen on the way.
    frame_time : bool
        Whether the time is that within the period of the system frame number, to be settled by the epoch
        before.
    """

    number: int
    time_s: float
    body: str
    paths: int
    frame_time: bool = False


@dataclass(frozen=True)
class EpochLimits:
    """How much a request may bring.

    Parameters
    ----------
    epochs : int
        In one request.
    paths_per_anchor : int
        In one epoch.
    walls : int
        That a sweep may see.
    """

    epochs: int
    paths_per_anchor: int
    walls: int

    def check_count(self, count: int) -> None:
        """Raise TooLargeError where a request has too many epochs."""
        if count > self.epochs:
            raise TooLargeError(f"epochs: expected at most {self.epochs} in a request, got {count}")

    def check(self, epoch: Epoch) -> None:
        """Raise TooLargeError where an epoch has too many paths or walls."""
        most = max((len(paths) for paths in epoch.paths), default=0)
        for what, limit, got in (
            ("paths of an anchor", self.paths_per_anchor, most),
            ("walls in a sweep", self.walls, len(epoch.sweep)),
        ):
            if got > limit:
                raise TooLargeError(f"epoch {epoch.index}: expected at most {limit} {what}, got {got}")


def entries_of(epochs: Sequence[Epoch] | Iterable[Epoch], limits: EpochLimits) -> tuple[EpochEntry, ...]:
    """Epochs as entries of the log, within the limits; raises TooLargeError."""
    found = []
    for epoch in epochs:
        limits.check(epoch)
        paths = sum(len(entry) for entry in epoch.paths) + len(epoch.sweep)
        found.append(EpochEntry(epoch.index, epoch.time_s, epoch_text(epoch), paths))
    return tuple(found)


def settled(entries: Sequence[EpochEntry], before_s: float | None) -> tuple[EpochEntry, ...]:
    """Entries whose frame times are times: each is the first with its stamp after the epoch before.

    Parameters
    ----------
    entries : sequence of EpochEntry
        Consecutive epochs.
    before_s : float or None
        Time of the epoch before the first; None if there is none.
    """
    found = []
    for entry in entries:
        made = entry
        if entry.frame_time:
            time_s = _next_s(entry.time_s, before_s)
            body = epoch_text(replace(read_epoch(entry.body), time_s=time_s))
            made = EpochEntry(entry.number, time_s, body, entry.paths)
        before_s = made.time_s
        found.append(made)
    return tuple(found)


def _next_s(frame_s: float, before_s: float | None) -> float:
    """The first time after ``before_s`` that is ``frame_s`` but for whole periods of the frame number."""
    if before_s is None or before_s < frame_s:
        return frame_s
    periods = math.floor((before_s - frame_s) / FRAME_PERIOD_S) + 1
    return frame_s + periods * FRAME_PERIOD_S
