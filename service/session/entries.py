"""Epochs on their way into the log: as text, with what is asked about them before they are stepped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from estimator.measurements import Epoch
from service.errors import TooLargeError
from service.messages.documents import epoch_text

__all__ = ["EpochEntry", "EpochLimits", "entries_of"]


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
    """

    number: int
    time_s: float
    body: str
    paths: int


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
