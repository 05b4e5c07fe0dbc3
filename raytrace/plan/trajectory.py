"""The agent's track: way-points, smoothed by a moving average, sampled at equal steps; and its direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError

__all__ = ["smoothed_track", "travel_azimuths"]

_FINE_STEPS = 20_000
# Half the chord that stands for the tangent of the curve.
_CHORD_M = 0.01


def smoothed_track(
    waypoints_m: ArrayLike, smoothing_m: float, step_m: float, epochs: int
) -> NDArray[np.float64]:
    """Positions at equal steps along a smoothed polyline.

    The polyline through the way-points is averaged over a window of length
    ``smoothing_m`` of its arc length; near its ends the window shrinks
    symmetrically, so that the track starts at the first way-point. The average is
    taken in closed form: it is the difference of the polyline's integral, which is
    piecewise quadratic, at the two ends of the window.

    Parameters
    ----------
    waypoints_m : array_like, shape (n, 2)
        Way-points, metres, neighbours distinct.
    smoothing_m : float
        Window length, metres; zero leaves the polyline as it is.
    step_m : float
        Distance between neighbouring positions along the track, metres.
    epochs : int
        Number of positions.

    Returns
    -------
    ndarray, shape (epochs, 2)

    Raises
    ------
    InputError
        If the track is shorter than ``(epochs - 1) * step_m``.
    """
    fine, travelled = _smoothed(waypoints_m, smoothing_m)
    needed = (epochs - 1) * step_m
    if needed > travelled[-1] + 1e-9:
        raise InputError(
            f"epochs: expected at most {int(travelled[-1] / step_m + 1e-9) + 1} positions {step_m:g} m apart "
            f"on a track of {travelled[-1]:.2f} m, got {epochs}"
        )
    at = np.arange(epochs) * step_m
    return np.stack([np.interp(at, travelled, fine[:, axis]) for axis in range(2)], axis=-1)


def travel_azimuths(
    waypoints_m: ArrayLike, smoothing_m: float, step_m: float, epochs: int
) -> NDArray[np.float64]:
    """Directions of travel at the positions of :func:`smoothed_track`.

    They are those of the smoothed curve itself, so that a longer walk along it leaves
    the directions of its first epochs as they are.

    Returns
    -------
    ndarray, shape (epochs,)
        Azimuths, radians.
    """
    fine, travelled = _smoothed(waypoints_m, smoothing_m)
    at = np.arange(epochs) * step_m
    before, after = np.maximum(at - _CHORD_M, 0.0), np.minimum(at + _CHORD_M, travelled[-1])
    x, y = (np.interp(after, travelled, axis) - np.interp(before, travelled, axis) for axis in fine.T)
    return np.asarray(np.arctan2(y, x))


def _smoothed(waypoints_m: ArrayLike, smoothing_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The smoothed curve as many points (n, 2), and the length travelled up to each, (n,), metres."""
    points = np.asarray(waypoints_m, dtype=np.float64)
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    arc = np.union1d(np.linspace(0.0, knots[-1], _FINE_STEPS), knots)
    half = np.minimum(0.5 * smoothing_m, np.minimum(arc, knots[-1] - arc))
    plain = _polyline(points, knots, arc)
    flat = half < 1e-6
    width = np.where(flat, 1.0, 2.0 * half)[:, None]
    mean = (_integral(points, knots, arc + half) - _integral(points, knots, arc - half)) / width
    fine = np.where(flat[:, None], plain, mean)

    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    return fine, travelled


def _polyline(
    points: NDArray[np.float64], knots: NDArray[np.float64], arc: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points of the polyline at arc lengths, shape (n, 2)."""
    return np.stack([np.interp(arc, knots, points[:, axis]) for axis in range(2)], axis=-1)


def _integral(
    points: NDArray[np.float64], knots: NDArray[np.float64], arc: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Integral of the polyline over arc length from 0, shape (n, 2): exact by the trapezium rule."""
    lengths = np.diff(knots)[:, None]
    whole = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (points[1:] + points[:-1]) * lengths, axis=0)])
    index = np.clip(np.searchsorted(knots, arc, side="right") - 1, 0, len(knots) - 2)
    part = (arc - knots[index])[:, None]
    return np.asarray(whole[index] + 0.5 * (points[index] + _polyline(points, knots, arc)) * part)
