"""The paths of an epoch as padded arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch
from estimator.waveform import free_space_loss_db

__all__ = ["PathTable", "stack_paths"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PathTable:
    """The paths of an epoch as padded arrays.

    Parameters
    ----------
    length_m, std_m : ndarray, shape (K, M)
        Path lengths and their standard deviations.
    excess_loss_db : ndarray, shape (K, M)
        Loss beyond free space, dB; NaN if powers are unknown.
    valid : ndarray of bool, shape (K, M)
        Which entries are measurements; an anchor's come first.
    azimuth_rad, azimuth_std_rad : ndarray, shape (K, M), or None
        Directions of arrival in the agent's axes; None if no anchor gave any, a
        standard deviation of infinity where one did not.
    heading_held : bool
        Whether the agent's axes are those of the start.
    """

    length_m: Array
    std_m: Array
    excess_loss_db: Array
    valid: NDArray[np.bool_]
    azimuth_rad: Array | None = None
    azimuth_std_rad: Array | None = None
    heading_held: bool = True

    def turned(self, angle_rad: float) -> PathTable:
        """The same paths in axes turned so that azimuths grow by ``angle_rad``."""
        if self.azimuth_rad is None:
            return self
        return replace(self, azimuth_rad=self.azimuth_rad + angle_rad)


def stack_paths(epoch: Epoch, carrier_hz: float) -> PathTable:
    """The paths of an epoch in one table."""
    shape = (len(epoch.paths), max((len(paths) for paths in epoch.paths), default=0) or 1)
    length, std, loss = np.ones(shape), np.ones(shape), np.full(shape, np.nan)
    valid = np.zeros(shape, dtype=bool)
    for k, paths in enumerate(epoch.paths):
        n = len(paths)
        length[k, :n], std[k, :n], valid[k, :n] = paths.range_m, paths.range_std_m, True
        if paths.gain_db is not None:
            loss[k, :n] = -paths.gain_db - free_space_loss_db(paths.range_m, carrier_hz)
    if all(paths.azimuth_rad is None for paths in epoch.paths):
        return PathTable(length, std, loss, valid)
    azimuth, azimuth_std = np.zeros(shape), np.full(shape, np.inf)
    for k, paths in enumerate(epoch.paths):
        if paths.azimuth_rad is not None and paths.azimuth_std_rad is not None:
            azimuth[k, : len(paths)], azimuth_std[k, : len(paths)] = paths.azimuth_rad, paths.azimuth_std_rad
    return PathTable(length, std, loss, valid, azimuth, azimuth_std, epoch.heading_held)
