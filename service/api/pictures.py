"""Pictures that were made, kept as long as there is room: those of an epoch never change."""

from __future__ import annotations

from collections import OrderedDict

__all__ = ["PictureCache"]

Name = tuple[str, int, str]


class PictureCache:
    """The pictures last asked for.

    Parameters
    ----------
    most_bytes : int
        All pictures together.
    """

    def __init__(self, most_bytes: int = 32 * 2**20) -> None:
        self._most, self._size = most_bytes, 0
        self._known: OrderedDict[Name, bytes] = OrderedDict()

    def get(self, name: Name) -> bytes | None:
        """The picture of a session, an epoch and a format, if it is known."""
        if name in self._known:
            self._known.move_to_end(name)
        return self._known.get(name)

    def forget(self, session_id: str) -> None:
        """Pictures of a session that are no longer true."""
        for name in [name for name in self._known if name[0] == session_id]:
            self._size -= len(self._known.pop(name))

    def put(self, name: Name, content: bytes) -> None:
        """Keep a picture; those not asked for longest go."""
        self._size += len(content) - len(self._known.pop(name, b""))
        self._known[name] = content
        while self._size > self._most:
            self._size -= len(self._known.popitem(last=False)[1])
