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
_HEARD = 0.3  # visibility from which a wall's paths are what is known of it
_MOST_RAD = 0.3  # beyond, a tangent says nothing of the circle


def turned(
    before: Array, mean: Array, covariance: Array, visibility: Array, layout: Layout
) -> tuple[Array, Array]:
    """Corrected rows whose walls went along circles round the anchors that are heard over them.

    Parameters
    ----------
    before : ndarray, shape (R, n)
        Means before the correction.
    mean, covariance : ndarray, shapes (R, n) and (R, n, n)
        Corrected Gaussians.
    visibility : ndarray, shape (R, K, F)
        Probability that each feature can be heard, 0 of those that a row lacks. Of several anchors
        the one heard best is a wall's.
    layout : Layout
        Positions in the state vector; the first wall is the gauge's, which does not turn.

    Returns
    -------
    mean, covariance : ndarray
        Mean and covariance in the order of ``n``.
    """
    if layout.slots < 2:
        return mean, covariance
    over = visibility[:, :, 2 : 1 + layout.slots]  # (R, K, L - 1)
    anchor = np.argmax(over, axis=1)
    line = np.arange(len(mean))[:, None]
    heard = over[line, anchor, np.arange(layout.slots - 1)] > _HEARD
    wall = layout.wall(1).start + 2 * np.arange(layout.slots - 1)
    about = layout.FIRST_ANCHOR + layout.PER_ANCHOR * anchor  # (R, L - 1)

    def arm(state: Array) -> NDArray[np.complex128]:
        """From the anchors to the walls, plane vectors as complex numbers."""
        x = state[:, wall] - state[line, about]
        return np.asarray(x + 1j * (state[:, wall + 1] - state[line, about + 1]))

    old, new = arm(before), arm(mean)
    length = np.abs(old)
    shift = (new - old) * old.conj() / length  # along the arm, and across
    angle = np.clip(np.where(heard, shift.imag / length, 0.0), -_MOST_RAD, _MOST_RAD)
    turn = np.exp(1j * angle)
    end = np.where(heard, old / length * (length + shift.real) * turn, new)
    mean = mean.copy()
    mean[:, wall] += end.real - new.real
    mean[:, wall + 1] += end.imag - new.imag
    covariance = _turned_rows(covariance, wall, about, turn).transpose(0, 2, 1)
    return mean, _turned_rows(covariance, wall, about, turn)


def _turned_rows(
    covariance: Array, wall: NDArray[np.int64], about: NDArray[np.int64], turn: NDArray[np.complex128]
) -> Array:
    """The covariance with the walls' rows turned, relative to those of their anchors."""
    line = np.arange(len(covariance))[:, None]
    anchor = covariance[line, about] + 1j * covariance[line, about + 1]  # (R, L - 1, n)
    own = covariance[:, wall] + 1j * covariance[:, wall + 1]
    own = anchor + turn[..., None] * (own - anchor)
    result = covariance.copy()
    result[:, wall], result[:, wall + 1] = own.real, own.imag
    return result
