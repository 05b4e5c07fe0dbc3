"""How long a session's epochs take, by those before: what is slow is sent where it keeps nobody waiting.

Processor time counts: a machine that is busy with others' work does not make a session slow.
"""

from __future__ import annotations

from collections import OrderedDict

__all__ = ["Pace"]

_REMEMBERED = 4096  # sessions
_UNKNOWN_S = 15e-6  # of a pair of a path and a wall, before a session has been seen: a room's on a laptop


class Pace:
    """Processor seconds of a pair of a path and a wall, session by session."""

    def __init__(self) -> None:
        self._seconds: OrderedDict[str, float] = OrderedDict()

    def expected_s(self, session_id: str, pairs: int) -> float:
        """How long so many pairs will take."""
        return pairs * self._seconds.get(session_id, _UNKNOWN_S)

    def note(self, session_id: str, pairs: int, seconds: float) -> None:
        """Remember how long they took; half of what was known stays."""
        before = self._seconds.pop(session_id, _UNKNOWN_S)
        self._seconds[session_id] = 0.5 * (before + seconds / max(pairs, 1))
        if len(self._seconds) > _REMEMBERED:
            self._seconds.popitem(last=False)
