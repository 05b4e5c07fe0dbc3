"""A correction moves far walls along circles, not along their tangents.

A path over a wall tells how far its VRP is from the anchor (as long as the agent is near RP): the VRP
lies on a circle round the anchor, and what is known of it is long along the circle and thin across.
A Gaussian in ``x, y`` holds the tangent of that circle. Where later epochs move the VRP by ``s``
along it, the tangent leaves the circle by ``s^2 / 2 r``, which after tens of epochs is many of the thin
standard deviations. So the move is taken in polar coordinates of the anchor: the VRP goes along the
circle, and its errors relative to the anchor turn with it. That is the update of a filter that holds the
walls in such coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.layout import Layout

__all__ = ["turned"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_MOST_RAD = 0.3  # a wall that moves by more is moved as it is: a tangent says nothing of such an arc


def turned(
    before: Array, mean: Array, covariance: Array, located: NDArray[np.bool_], layout: Layout
) -> tuple[Array, Array]:
    """Corrected rows whose walls went along circles round anchors.

    Of several anchors the one that a wall's distance is known best from is its centre.

    Parameters
    ----------
    before : ndarray, shape (R, n)
        Means before the correction.
    mean, covariance : ndarray, shapes (R, n) and (R, n, n)
        Corrected Gaussians.
    located : ndarray of bool, shape (R, K)
        Anchors that have been located.
    layout : Layout
        Positions in the state vector; the first wall is the gauge's, which does not turn.

    Returns
    -------
    mean, covariance : ndarray
        Shapes (R, n) and (R, n, n).
    """
    if layout.slots < 2:
        return mean, covariance
    wall = layout.wall(1).start + 2 * np.arange(layout.slots - 1)
    about = layout.FIRST_ANCHOR + layout.PER_ANCHOR * np.arange(layout.anchors)[:, None]
    variance = _distance_variance(mean, covariance, wall, about)  # (R, K, L - 1)
    centre = np.argmin(np.where(located[..., None], variance, np.inf), axis=1)
    about = about[centre, 0]  # (R, L - 1)
    line = np.arange(len(mean))[:, None]

    def arm(state: Array) -> NDArray[np.complex128]:
        """From the anchors to the walls, plane vectors as complex numbers."""
        x = state[:, wall] - state[line, about]
        return np.asarray(x + 1j * (state[:, wall + 1] - state[line, about + 1]))

    old = arm(before)
    length = np.abs(old)
    shift = (arm(mean) - old) * old.conj() / length  # along the arm, and across
    turns = located.any(axis=1, keepdims=True) & (np.abs(shift.imag) < _MOST_RAD * length)
    across = np.where(turns, shift.imag, 0.0)
    turn = np.exp(1j * across / length)
    bend = old / length * ((length + shift.real) * (turn - 1.0) - 1j * across)
    mean = mean.copy()
    mean[:, wall] += bend.real
    mean[:, wall + 1] += bend.imag
    covariance = _turned_rows(covariance, wall, about, turn).transpose(0, 2, 1)
    return mean, _turned_rows(covariance, wall, about, turn)


def _distance_variance(mean: Array, covariance: Array, wall: Index, about: Index) -> Array:
    """Variance (R, K, L) of the distances of the walls (L,) from the anchors (K, 1)."""
    wall = wall[None]
    x, y = mean[:, wall] - mean[:, about], mean[:, wall + 1] - mean[:, about + 1]
    square = x * x + y * y

    def product(i: Index, j: Index) -> Array:
        mixed = covariance[:, i, j + 1] + covariance[:, i + 1, j]
        return np.asarray(x * x * covariance[:, i, j] + x * y * mixed + y * y * covariance[:, i + 1, j + 1])

    total = product(wall, wall) - 2.0 * product(wall, about) + product(about, about)
    return np.asarray(total / square)


def _turned_rows(covariance: Array, wall: Index, about: Index, turn: NDArray[np.complex128]) -> Array:
    """The covariance with the walls' rows turned, relative to those of their anchors."""
    line = np.arange(len(covariance))[:, None]
    anchor = covariance[line, about] + 1j * covariance[line, about + 1]  # (R, L - 1, n)
    own = covariance[:, wall] + 1j * covariance[:, wall + 1]
    more = (turn[..., None] - 1.0) * (own - anchor)
    result = covariance.copy()
    result[:, wall] += more.real
    result[:, wall + 1] += more.imag
    return result
