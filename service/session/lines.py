"""Epochs one a line, as a stream brings them: those before the first that cannot be read."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydantic import TypeAdapter

from estimator.errors import HapslamError
from service.messages.epochs import AnyEpoch
from service.messages.terms import SessionTerms
from service.session.bodies import parsed_by
from service.session.entries import EpochEntry, EpochLimits, entries_of
from service.session.tasks import TaskContext

__all__ = ["LinesTask"]

_EPOCH: TypeAdapter[AnyEpoch] = TypeAdapter(AnyEpoch)


@dataclass(frozen=True)
class LinesTask:
    """Lines as entries of the log.

    Parameters
    ----------
    lines : tuple of bytes
        JSON, each an epoch as ``epochs`` takes it.
    terms : SessionTerms
        The session's.
    limits : EpochLimits
        How much an epoch may bring.
    """

    lines: tuple[bytes, ...]
    terms: SessionTerms
    limits: EpochLimits

    def run(self, context: TaskContext) -> tuple[tuple[EpochEntry, ...], HapslamError | None]:
        """The entries of all lines before the first that cannot be read, and what is wrong with that one."""
        del context
        found: list[EpochEntry] = []
        for line in self.lines:
            try:
                given = parsed_by(_EPOCH.validate_python, line)
                (entry,) = entries_of([given.estimator_epoch(self.terms)], self.limits)
            except HapslamError as error:
                return tuple(found), error
            found.append(replace(entry, frame_time=given.frame_time))
        return tuple(found), None
