"""Encoded messages of positioning in the service: one becomes an epoch, in a worker process."""

from __future__ import annotations

from dataclasses import dataclass, replace

from service.messages.asn1 import Protocol, decoded
from service.messages.documents import dump
from service.messages.nr_epoch import NrEpoch
from service.messages.terms import SessionTerms
from service.session.bodies import parsed
from service.session.entries import EpochEntry, EpochLimits, entries_of
from service.session.tasks import TaskContext

__all__ = ["PduTask"]


@dataclass(frozen=True)
class PduTask:
    """Decode a message and read it as an epoch.

    Parameters
    ----------
    protocol : str
        ``"lpp"`` or ``"nrppa"``; see :func:`service.messages.asn1.decoded`.
    body : bytes
        The encoded message.
    epoch : int
        Number of the epoch.
    time_s : float or None
        Its time; None for the frame number's.
    terms : SessionTerms
        The session's.
    limits : EpochLimits
        How much it may bring.
    """

    protocol: Protocol
    body: bytes
    epoch: int
    time_s: float | None
    terms: SessionTerms
    limits: EpochLimits

    def run(self, context: TaskContext) -> tuple[EpochEntry, ...]:
        """Decode and read; raises FileFormatError, ValidationError, InputError or TooLargeError."""
        del context
        content = {
            "epoch": self.epoch,
            "time_s": self.time_s,
            self.protocol: decoded(self.protocol, self.body),
        }
        given = parsed(NrEpoch, dump(content).encode())
        (entry,) = entries_of([given.estimator_epoch(self.terms)], self.limits)
        return (replace(entry, frame_time=given.frame_time),)
