"""The path buffer: where the agent was in recent epochs, and which paths it heard there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
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
        return _with_epoch(self, epoch, position_m, std_m, paths, associated, window)

    def thinned(self) -> PathBuffer:
        """The buffer with every other epoch only, the last one kept."""
        track, every = self.track, slice((self.epochs - 1) % 2, None, 2)
        kept = Track(track.epoch[every], track.position_m[every], track.std_m[every])
        return self._only(np.isin(self.epoch, kept.epoch))._replace(track=kept)

    def of_anchors(self, which: Mask) -> PathBuffer:
        """The buffer with the paths of some anchors (K,) alone; the track stays."""
        return self._only(which[self.anchor])

    def shifted(self, length_m: Array) -> PathBuffer:
        """The buffer with a length (K,) added to all paths of each anchor, metres."""
        return self._replace(length_m=self.length_m + length_m[self.anchor])

    def _only(self, stay: Mask) -> PathBuffer:
        """The track, and some of the paths (N,)."""
        return PathBuffer(
            self.track,
            self.epoch[stay],
            self.anchor[stay],
            self.length_m[stay],
            self.std_m[stay],
            self.excess_loss_db[stay],
            self.unassociated[stay],
        )

    def columns(self, kind: str) -> dict[str, NDArray[Any]]:
        """Its arrays by the names that an archive has for them, which begin with ``kind``."""
        own = {f"{kind}.{name}": column for name, column in zip(self._fields[1:], self[1:], strict=True)}
        return own | {f"{kind}.track.{name}": getattr(self.track, name) for name in Track._fields}

    @classmethod
    def of_columns(cls, columns: Mapping[str, NDArray[Any]], kind: str) -> PathBuffer:
        """The buffer that gave :meth:`columns`."""
        track = Track(*(columns[f"{kind}.track.{name}"] for name in Track._fields))
        return cls(track, *(columns[f"{kind}.{name}"] for name in cls._fields[1:]))

    def with_associated(self, which: Mask | Index) -> PathBuffer:
        """The buffer with the paths ``which`` marked as associated: they start nothing any more."""
        unassociated = self.unassociated.copy()
        unassociated[which] = False
        return self._replace(unassociated=unassociated)


@compiled
def _with_epoch(
    buffer: PathBuffer,
    epoch: int,
    position_m: Array,
    std_m: float,
    paths: EpochPaths,
    associated: Mask,
    window: int,
) -> PathBuffer:
    track = buffer.track
    old = first = 0
    while old < track.epoch.size and track.epoch[old] <= epoch - window:
        old += 1
    while first < buffer.epoch.size and buffer.epoch[first] <= epoch - window:
        first += 1
    kept = track.epoch.size - old
    place = Track(np.empty(kept + 1, dtype=np.int64), np.empty((kept + 1, 2)), np.empty(kept + 1))
    for i in range(kept):
        place.epoch[i], place.std_m[i] = track.epoch[old + i], track.std_m[old + i]
        place.position_m[i, 0], place.position_m[i, 1] = (
            track.position_m[old + i, 0],
            track.position_m[old + i, 1],
        )
    place.epoch[kept], place.std_m[kept] = epoch, std_m
    place.position_m[kept, 0], place.position_m[kept, 1] = position_m[0], position_m[1]
    n = buffer.epoch.size - first
    total = n + paths.number.sum()
    after = PathBuffer(
        place,
        np.empty(total, dtype=np.int64),
        np.empty(total, dtype=np.int64),
        np.empty(total),
        np.empty(total),
        np.empty(total),
        np.empty(total, dtype=np.bool_),
    )
    for i in range(n):
        after.epoch[i], after.anchor[i] = buffer.epoch[first + i], buffer.anchor[first + i]
        after.length_m[i], after.std_m[i] = buffer.length_m[first + i], buffer.std_m[first + i]
        after.excess_loss_db[i] = buffer.excess_loss_db[first + i]
        after.unassociated[i] = buffer.unassociated[first + i]
    for k in range(paths.number.size):
        for j in range(paths.number[k]):
            after.epoch[n], after.anchor[n] = epoch, k
            after.length_m[n], after.std_m[n] = paths.length_m[k, j], paths.std_m[k, j]
            after.excess_loss_db[n] = paths.excess_loss_db[k, j]
            after.unassociated[n] = not associated[k, j]
            n += 1
    return after
