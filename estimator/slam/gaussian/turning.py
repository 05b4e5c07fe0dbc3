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

from estimator.slam.features import Complex
from estimator.slam.layout import Layout

__all__ = ["turned"]

Array = NDArray[np.float64]
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
    line, first = np.arange(len(mean))[:, None], layout.wall(1).start
    device = slice(layout.FIRST_ANCHOR, layout.walls.start, layout.PER_ANCHOR)

    def arm(state: Array) -> Complex:
        """From the anchors to the walls (R, K, L - 1)."""
        wall, anchor = state[:, first::2] + 1j * state[:, first + 1 :: 2], _rows_of(state, device)
        return np.asarray(wall[:, None] - anchor[:, :, None])

    old, new = arm(before), arm(mean)
    own, anchor = _rows_of(covariance, slice(first, None, 2)), _rows_of(covariance, device)
    variance = _distance_variance(new, own, anchor, first, device)
    centre = np.argmin(np.where(located[..., None], variance, np.inf), axis=1)  # (R, L - 1)
    chosen = line, centre, np.arange(layout.slots - 1)
    old, new = old[chosen], new[chosen]
    length = np.abs(old)
    shift = (new - old) * old.conj() / length  # along the arm, and across
    turns = located.any(axis=1, keepdims=True) & (np.abs(shift.imag) < _MOST_RAD * length)
    across = np.where(turns, shift.imag, 0.0)
    turn = np.exp(1j * across / length) - 1.0
    bend = old / length * ((length + shift.real) * turn - 1j * across)
    mean, covariance = mean.copy(), covariance.copy()
    mean[:, first::2] += bend.real
    mean[:, first + 1 :: 2] += bend.imag
    more = turn[..., None] * (own - anchor[line, centre])
    covariance[:, first::2] += more.real
    covariance[:, first + 1 :: 2] += more.imag
    columns = covariance.transpose(0, 2, 1)  # a view
    about = device.start + layout.PER_ANCHOR * centre
    more = _rows_of(columns, slice(first, None, 2)) - (columns[line, about] + 1j * columns[line, about + 1])
    more *= turn[..., None]
    columns[:, first::2] += more.real
    columns[:, first + 1 :: 2] += more.imag
    return mean, covariance


def _rows_of(array: Array, x: slice) -> Complex:
    """Entries ``x`` of the second axis, and the ones that follow them, as one complex array."""
    y = slice(x.start + 1, None if x.stop is None else x.stop + 1, x.step)
    return np.asarray(array[:, x] + 1j * array[:, y])


def _distance_variance(arm: Complex, own: Complex, anchor: Complex, wall: int, device: slice) -> Array:
    """Variance (R, K, L) of the lengths of arms, given the walls' and anchors' rows of the covariance."""

    def by(shift: int) -> Complex:
        """The covariances of the arms with their x or y."""
        walls, anchors = slice(wall + shift, None, 2), slice(device.start + shift, device.stop, device.step)
        each = (
            np.einsum("rll->rl", own[..., walls])[:, None]
            + np.einsum("rkk->rk", anchor[..., anchors])[..., None]
        )
        return np.asarray(each - anchor[..., walls] - own[..., anchors].transpose(0, 2, 1))

    both = arm.real * by(0) + arm.imag * by(1)
    return np.asarray((both * arm.conj()).real / (arm * arm.conj()).real)
