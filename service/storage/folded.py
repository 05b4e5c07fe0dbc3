"""What is written of epochs that were folded into a session's state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["Folded"]


@dataclass(frozen=True)
class Folded:
    """What came of a :class:`service.session.fold.Job`.

    Parameters
    ----------
    snapshot : bytes
        The state after the last epoch.
    sha256 : bytes
        Its digest.
    estimates : tuple of dict
        A row of the table ``estimates`` for each epoch, without the session.
    processor_s : float
        Processor time that it took, seconds.
    integrity : str
        Whether the last epoch may be relied on: ``ok``, ``doubtful``, ``lost`` or ``unknown``.
    """

    snapshot: bytes
    sha256: bytes
    estimates: tuple[dict[str, Any], ...]
    processor_s: float
    integrity: str = "unknown"
