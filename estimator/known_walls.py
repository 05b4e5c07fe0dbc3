"""Walls that are known beforehand, from a floor plan: as virtual reference points about the agent's start."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.geometry import rotation_matrix, vrp_of_line
from estimator.measurements import GaussianVrp

__all__ = ["known_walls"]

_LOG = logging.getLogger("hapslam")
_THROUGH_RP_M = 0.2  # a line that comes closer to the start has no reference point worth the name
_SAME_LINE_STDS = 3.0  # lines whose reference points are so near are one line, drawn in pieces


def known_walls(
    from_m: ArrayLike,
    to_m: ArrayLike,
    start_m: ArrayLike,
    heading_rad: float = 0.0,
    std_m: float = 0.05,
    most: int = 24,
) -> tuple[GaussianVrp, ...]:
    """The walls of a plan as a run takes them that knows its place in the plan.

    Walls in one line are one; those that come nearest to the start first. What is left out is noted.

    Parameters
    ----------
    from_m, to_m : array_like, shape (L, 2)
        Both ends of every wall, plan's frame, metres.
    start_m : array_like, shape (2,)
        Where the agent starts, plan's frame, metres.
    heading_rad : float
        Direction of the agent's x axis at the start in the plan, radians.
    std_m : float
        Standard deviation of where the plan draws a wall, metres: of its reference point it is twice that.
    most : int
        Walls that are taken; time of a run grows with the square of their number.

    Raises
    ------
    InputError
        If shapes do not fit, numbers are not finite, the deviation is not positive, or no wall is left.
    """
    begin, end = np.asarray(from_m, dtype=np.float64), np.asarray(to_m, dtype=np.float64)
    start = np.asarray(start_m, dtype=np.float64)
    if begin.ndim != 2 or begin.shape[1:] != (2,) or end.shape != begin.shape or start.shape != (2,):
        raise InputError(
            "from_m, to_m, start_m: expected shapes (L, 2), (L, 2) and (2,), "
            f"got {begin.shape}, {end.shape} and {start.shape}"
        )
    if not (np.isfinite(begin).all() and np.isfinite(end).all() and np.isfinite([*start, heading_rad]).all()):
        raise InputError("from_m, to_m, start_m, heading_rad: expected finite numbers, got others")
    if not 0.0 < std_m < np.inf or most < 1:
        raise InputError(f"std_m, most: expected positive numbers, got {std_m} and {most}")
    long = np.linalg.norm(end - begin, axis=1) > 0.0
    begin, end = begin[long], end[long]
    along = end - begin
    share = np.clip(np.sum((start - begin) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
    near = np.argsort(np.linalg.norm(begin + share[:, None] * along - start, axis=1), kind="stable")
    turn = rotation_matrix(-heading_rad)
    vrps = (vrp_of_line(begin, end, start) - start) @ turn.T if len(begin) else np.empty((0, 2))
    found: list[NDArray[np.float64]] = []
    through = 0
    for vrp in vrps[near]:
        if np.linalg.norm(vrp) < 2.0 * _THROUGH_RP_M:
            through += 1
        elif all(np.linalg.norm(vrp - other) > 2.0 * _SAME_LINE_STDS * std_m for other in found):
            found.append(vrp)
    if not found:
        raise InputError(
            f"floor plan: expected walls whose lines do not pass through the start, got {len(begin)} walls"
        )
    if through:
        _LOG.info("walls in line with the start are left out: %d", through)
    if len(found) > most:
        _LOG.info("of %d lines of walls the %d nearest to the start are taken", len(found), most)
    return tuple(GaussianVrp(vrp, (2.0 * std_m) ** 2 * np.eye(2)) for vrp in found[:most])
