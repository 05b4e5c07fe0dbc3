"""The paths of an epoch as padded arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch
from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db

__all__ = ["EpochPaths", "stack_paths"]

Array = NDArray[np.float64]


class EpochPaths(NamedTuple):
    """The paths of an epoch, K anchors with up to M paths; compiled functions take it as it is.

    Parameters
    ----------
    number : ndarray of int64, shape (K,)
        Paths of each anchor; they come first in its row.
    length_m, std_m : ndarray, shape (K, M)
        Path lengths and their standard deviations; the rest is 1.
    excess_loss_db : ndarray, shape (K, M)
        Loss beyond free space, dB; NaN if powers are unknown.
    azimuth_rad, azimuth_std_rad : ndarray, shape (K, M)
        Directions of arrival in the agent's axes, the x axis being the gauge frame's at the start; the
        standard deviation is infinite where there is none.
    heading_held : bool
        Whether the agent's axes are those of the start.
    asked : ndarray of bool, shape (K,)
        Which anchors were asked: of another, silence says nothing.
    """

    number: NDArray[np.int64]
    length_m: Array
    std_m: Array
    excess_loss_db: Array
    azimuth_rad: Array
    azimuth_std_rad: Array
    heading_held: bool
    asked: NDArray[np.bool_]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which entries (K, M) are measurements."""
        return np.asarray(np.arange(self.length_m.shape[1]) < self.number[:, None])


def stack_paths(epoch: Epoch, carrier_hz: float, bearing_rad: float = 0.0) -> EpochPaths:
    """The paths of an epoch in one table.

    Parameters
    ----------
    epoch : Epoch
        Paths of K anchors.
    carrier_hz : float
        Carrier frequency, hertz.
    bearing_rad : float
        Direction of the gauge frame's x axis in the estimator's frame.
    """
    count = np.array([len(paths) for paths in epoch.paths], dtype=np.int64)
    shape = len(count), max(int(count.max(initial=0)), 1)
    length, std = np.ones(shape), np.ones(shape)
    loss, azimuth, azimuth_std = np.full(shape, np.nan), np.zeros(shape), np.full(shape, np.inf)
    for k, (paths, n) in enumerate(zip(epoch.paths, count.tolist(), strict=True)):
        if n == 0:
            continue
        length[k, :n] = paths.delay_s * SPEED_OF_LIGHT_M_S
        std[k, :n] = paths.delay_std_s * SPEED_OF_LIGHT_M_S
        if paths.gain_db is not None:
            loss[k, :n] = -paths.gain_db - free_space_loss_db(length[k, :n], carrier_hz)
        if paths.azimuth_rad is not None and paths.azimuth_std_rad is not None:
            azimuth[k, :n] = paths.azimuth_rad - bearing_rad
            azimuth_std[k, :n] = paths.azimuth_std_rad
    return EpochPaths(
        count, length, std, loss, azimuth, azimuth_std, bool(epoch.heading_held), epoch.was_asked
    )
