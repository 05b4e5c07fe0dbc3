"""A run's track as text that tools for trajectories read (the format of the TUM RGB-D benchmark)."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["tum_text"]


def tum_text(rows: Iterable[tuple[float, float, float]]) -> str:
    """Lines of ``timestamp tx ty tz qx qy qz qw``.

    Parameters
    ----------
    rows : iterable of (float, float, float)
        Time in seconds and position in metres. Height is 0 and the orientation that of the frame, for an
        agent's heading is not estimated.
    """
    lines = (f"{time_s!r} {x!r} {y!r} 0 0 0 0 1\n" for time_s, x, y in rows)
    return "# timestamp tx ty tz qx qy qz qw\n" + "".join(lines)
