"""Connections that neither send nor read are closed: each costs a file descriptor, and what it holds."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol

__all__ = ["Patience", "patient_protocol"]


@dataclass(frozen=True)
class Patience:
    """How long a connection is waited for.

    Parameters
    ----------
    head_s : float
        For the head of a request, from its first byte, or from the connection, to its end.
    reader_s : float
        For a client to take what was sent.
    head_bytes : int
        Largest head.
    """

    head_s: float
    reader_s: float = 60.0
    head_bytes: int = 2**16


def patient_protocol(patience: Patience) -> type[asyncio.Protocol]:
    """Uvicorn's HTTP protocol, with these limits."""

    class PatientProtocol(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
        """A connection that is closed where it keeps the server waiting."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._head, self._paused, self._body_due = 0, None, False
            self._late = self.loop.call_later(patience.head_s, transport.close)

        def connection_lost(self, error: Exception | None) -> None:
            self._late.cancel()
            self._cancel_pause()
            super().connection_lost(error)

        def data_received(self, data: bytes) -> None:
            if self._body_due:  # of a request that may have been answered already
                super().data_received(data)
                return
            if self._between_requests() and not self._head:
                self._watch(patience.head_s)
            self._head += len(data)
            super().data_received(data)
            if self._body_due or not self._between_requests():
                self._head = 0
                self._late.cancel()
            elif self._head > patience.head_bytes:
                self.transport.close()

        def on_headers_complete(self) -> None:
            self._body_due = True
            super().on_headers_complete()

        def handle_websocket_upgrade(self) -> None:
            self._late.cancel()
            super().handle_websocket_upgrade()

        def on_message_complete(self) -> None:
            self._body_due = False
            super().on_message_complete()

        def on_response_complete(self) -> None:
            super().on_response_complete()
            self._head = 0
            self._late.cancel()
            if self._body_due:  # refused by its head: the rest is thrown away, but not for ever
                self._watch(patience.reader_s)

        def pause_writing(self) -> None:
            super().pause_writing()
            self._paused = self.loop.call_later(patience.reader_s, self.transport.abort)

        def resume_writing(self) -> None:
            super().resume_writing()
            self._cancel_pause()

        def _between_requests(self) -> bool:
            return self.cycle is None or bool(self.cycle.response_complete)

        def _watch(self, seconds: float) -> None:
            self._late.cancel()
            self._late = self.loop.call_later(seconds, self.transport.close)

        def _cancel_pause(self) -> None:
            if self._paused is not None:
                self._paused.cancel()
                self._paused = None

    return PatientProtocol
