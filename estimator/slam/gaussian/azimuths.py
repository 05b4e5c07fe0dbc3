"""Directions of arrival: what they add to the association and to the correction.

With the heading held, directions are measured from the axes of the start and tell the
rotation of the map. With the heading unknown they share one unknown angle per epoch,
which is integrated out: only the angles between paths inform.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.slam.features import predict_azimuths
from estimator.slam.gaussian.kalman import kalman
from estimator.slam.gaussian.paths import PathTable
from estimator.slam.layout import Layout

__all__ = ["azimuth_ratio", "take_azimuths"]

Array = NDArray[np.float64]
_AGREE_RAD = 0.05  # directions closer than this propose one heading
_GATE = 4.0  # standard deviations
_ANY_HEADING_RAD2 = (2.0 * np.pi) ** 2 / 12.0


def _wrapped(angle_rad: Array) -> Array:
    return np.asarray(np.angle(np.exp(1j * angle_rad)))


def azimuth_ratio(
    mean: Array, covariance: Array, paths: PathTable, layout: Layout, feature: NDArray[np.int64]
) -> Array | float:
    """Likelihood of each direction under each feature over that of clutter from anywhere.

    Parameters
    ----------
    mean, covariance : ndarray, shapes (R, n) and (R, n, n)
        Predicted Gaussians.
    paths : PathTable
        The epoch's paths, azimuths in the gauge frame.
    layout : Layout
        Positions in the state vector.
    feature : ndarray of int64, shape (R, K, C)
        Features of each anchor.

    Returns
    -------
    ndarray, shape (R, K, C, M), or 1.0
        1 where there is no direction, or the heading is unknown.
    """
    if paths.azimuth_rad is None or paths.azimuth_std_rad is None or not paths.heading_held:
        return 1.0
    azimuth, jacobian = predict_azimuths(mean, layout, feature)
    rows, anchors, features, size = jacobian.shape
    flat = jacobian.reshape(rows, anchors * features, size)
    spread = np.sum((flat @ covariance) * flat, axis=-1).reshape(rows, anchors, features)
    angle, std = paths.azimuth_rad[..., None, :], paths.azimuth_std_rad[..., None, :]
    given = np.isfinite(std)
    noise = np.where(given, std, 1.0) ** 2
    s = spread[..., None] + noise
    innovation = _wrapped(angle - azimuth[..., None])
    density = np.exp(-0.5 * innovation**2 / s) / np.sqrt(2.0 * np.pi * s)
    return np.where(given, 2.0 * np.pi * density, 1.0)


def _turn(innovation: Array, use: NDArray[np.bool_]) -> Array:
    """Heading (R,) that most of the directions agree on: the densest of those proposed."""
    rows = len(innovation)
    angle, used = innovation.reshape(rows, -1), use.reshape(rows, -1)
    gap = np.abs(_wrapped(angle[:, :, None] - angle[:, None, :]))
    votes = np.sum(np.exp(-gap / _AGREE_RAD) * used[:, None, :], axis=-1) * used
    centre = np.take_along_axis(angle, np.argmax(votes, axis=1)[:, None], axis=1)
    near = used & (np.abs(_wrapped(angle - centre)) < 3.0 * _AGREE_RAD)
    return np.asarray(np.angle(np.sum(np.where(near, np.exp(1j * angle), 0.0), axis=1)))


def take_azimuths(
    mean: Array,
    covariance: Array,
    feature: NDArray[np.int64],
    label: NDArray[np.int64],
    paths: PathTable,
    layout: Layout,
) -> tuple[Array, Array, Array]:
    """Correct rows by the directions of the paths that features were found to have given.

    Parameters
    ----------
    mean, covariance : ndarray, shapes (R, n) and (R, n, n)
        Gaussians already corrected by the path lengths.
    feature : ndarray of int64, shape (R, K, C)
        Features of each anchor.
    label : ndarray of int64, shape (R, K, C)
        Path that each gave, -1 for none.
    paths, layout
        As for :func:`azimuth_ratio`.

    Returns
    -------
    mean, covariance : ndarray
        Corrected Gaussians.
    log_evidence : ndarray, shape (R,)
        Log density of the directions over that of directions from anywhere.
    """
    if paths.azimuth_rad is None or paths.azimuth_std_rad is None:
        return mean, covariance, np.zeros(len(mean))
    paths = paths.by_row()
    assert paths.azimuth_rad is not None
    assert paths.azimuth_std_rad is not None
    angle, std = (
        np.take_along_axis(each[:, :, None, :], label[..., None], axis=-1)[..., 0]
        for each in (paths.azimuth_rad, paths.azimuth_std_rad)
    )
    use = (label >= 0) & np.isfinite(std)
    columns = np.flatnonzero(use.reshape(len(mean), -1).any(axis=0))
    if columns.size == 0:
        return mean, covariance, np.zeros(len(mean))
    azimuth, jacobian = predict_azimuths(mean, layout, feature)
    innovation = angle - azimuth
    common = 0.0
    if not paths.heading_held:
        common = _ANY_HEADING_RAD2
        innovation = _wrapped(innovation - _turn(innovation, use)[:, None, None])
        flat_jacobian = jacobian.reshape(len(mean), -1, layout.size)
        spread = np.sum((flat_jacobian @ covariance) * flat_jacobian, axis=-1).reshape(innovation.shape)
        use &= innovation**2 < _GATE**2 * (2.0 * spread + std**2)
    flat = (len(mean), -1)
    keep = use.reshape(flat)[:, columns]
    mean, covariance, log_density = kalman(
        mean,
        covariance,
        np.where(keep[..., None], jacobian.reshape(*flat, layout.size)[:, columns], 0.0),
        np.where(keep, _wrapped(innovation).reshape(flat)[:, columns], 0.0),
        np.where(keep, std.reshape(flat)[:, columns] ** 2, 0.5 / np.pi),
        np.where(keep, np.sqrt(common), 0.0),
    )
    return mean, covariance, log_density + keep.sum(axis=1) * np.log(2.0 * np.pi)
