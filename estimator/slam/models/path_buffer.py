"""The path buffer: where the agent was in recent epochs, and which paths it heard there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.slam.models.epoch_paths import EpochPaths

__all__ = ["PathBuffer", "Track"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Track(NamedTuple):
    """The agent at the W recent epochs, oldest first.

    Parameters
    ----------
    epoch : ndarray of int64, shape (W,)
        Their numbers.
    position_m : ndarray, shape (W, 2)
        Positions in the likeliest hypothesis of each epoch, gauge frame, metres.
    std_m : ndarray, shape (W,)
        Standard deviations per axis, metres.
    """

    epoch: Index
    position_m: Array
    std_m: Array


class PathBuffer(NamedTuple):
    """The track and the paths of recent epochs, in the order of epochs; compiled functions take it as it is.

    Parameters
    ----------
    track : Track
        The W epochs.
    epoch, anchor : ndarray of int64, shape (N,)
        Epoch and anchor of each path.
    length_m, std_m : ndarray, shape (N,)
        Lengths and their standard deviations, metres.
    excess_loss_db : ndarray, shape (N,)
        Loss beyond free space, dB; NaN if unknown.
    unassociated : ndarray of bool, shape (N,)
        Whether no feature explains it.
    """

    track: Track
    epoch: Index
    anchor: Index
    length_m: Array
    std_m: Array
    excess_loss_db: Array
    unassociated: Mask

    @classmethod
    def empty(cls) -> PathBuffer:
        """A buffer without a past."""
        none, whole = np.empty(0), np.empty(0, dtype=np.int64)
        return cls(
            Track(whole, np.empty((0, 2)), none), whole, whole, none, none, none, np.empty(0, dtype=np.bool_)
        )

    @property
    def epochs(self) -> int:
        """Number of epochs W."""
        return len(self.track.epoch)

    def row_of(self, epoch: Index) -> Index:
        """The rows of the track that epochs stand in."""
        return np.searchsorted(self.track.epoch, epoch)

    def with_epoch(
        self, epoch: int, position_m: Array, std_m: float, paths: EpochPaths, associated: Mask, window: int
    ) -> PathBuffer:
        """The buffer with one more epoch; epochs ``window`` or more before it are forgotten.

        Parameters
        ----------
        epoch : int
            Its number.
        position_m, std_m
            The agent, as in :class:`Track`.
        paths : EpochPaths
            Its paths (K, M).
        associated : ndarray of bool, shape (K, M)
            Paths that something explains.
        window : int
            Epochs kept.
        """
        old = int(self.track.epoch.searchsorted(epoch - window, "right"))
        first = int(self.epoch.searchsorted(epoch - window, "right"))
        anchor, column = np.nonzero(paths.valid)
        track = Track(
            np.append(self.track.epoch[old:], epoch),
            np.concatenate([self.track.position_m[old:], position_m[None]]),
            np.append(self.track.std_m[old:], std_m),
        )
        return PathBuffer(
            track,
            np.concatenate([self.epoch[first:], np.full(len(anchor), epoch)]),
            np.concatenate([self.anchor[first:], anchor]),
            np.concatenate([self.length_m[first:], paths.length_m[anchor, column]]),
            np.concatenate([self.std_m[first:], paths.std_m[anchor, column]]),
            np.concatenate([self.excess_loss_db[first:], paths.excess_loss_db[anchor, column]]),
            np.concatenate([self.unassociated[first:], ~associated[anchor, column]]),
        )

    def with_associated(self, which: Mask | Index) -> PathBuffer:
        """The buffer with the paths ``which`` marked as associated: they start nothing any more."""
        unassociated = self.unassociated.copy()
        unassociated[which] = False
        return self._replace(unassociated=unassociated)
