"""The states that a worker process stepped last."""

from __future__ import annotations

from typing import Any

__all__ = ["StateCache"]


class StateCache:
    """The states last folded, so that a session's next epoch need not read its snapshot.

    A state is found again only by the digest of its snapshot, so it is the state that the
    snapshot would give.
    """

    def __init__(self, size: int = 64) -> None:
        self._size = size
        self._states: dict[str, tuple[bytes, Any]] = {}

    def get(self, session_id: str, sha256: bytes) -> Any | None:
        """The state of a session, if its snapshot is the one with that digest."""
        known, state = self._states.get(session_id, (b"", None))
        return state if known == sha256 else None

    def put(self, session_id: str, sha256: bytes, state: Any) -> None:
        """Keep a state; the longest unused one is forgotten."""
        self._states.pop(session_id, None)
        self._states[session_id] = sha256, state
        if len(self._states) > self._size:
            self._states.pop(next(iter(self._states)))
