"""The paths of an epoch as padded arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.measurements import Epoch
from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db

__all__ = ["PathTable", "pool_paths", "stack_paths"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PathTable:
    """The paths of an epoch as padded arrays.

    Parameters
    ----------
    length_m, std_m : ndarray, shape (K, M), or (R, K, M) for rows of several runs
        Path lengths and their standard deviations. The other arrays have this shape too.
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

    def by_row(self) -> PathTable:
        """The table with an axis for the rows: one entry stands for all of them."""
        return self if self.length_m.ndim == 3 else self._each(lambda column: column[None])

    def of_rows(self, index: NDArray[np.int64]) -> PathTable:
        """The table of the rows at ``index``; itself if one entry stands for all."""
        return self if len(self.length_m) == 1 else self._each(lambda column: column[index])

    def of_run(self, run: int) -> PathTable:
        """The table (K, M) of one of several runs."""
        return self._each(lambda column: column[run])

    def _each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> PathTable:
        columns: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        changed = {name: change(each) for name, each in columns.items() if isinstance(each, np.ndarray)}
        return PathTable(**{**columns, **changed})

    def turned(self, angle_rad: ArrayLike) -> PathTable:
        """The same paths in axes turned so that azimuths grow by ``angle_rad``, one or one of each run."""
        if self.azimuth_rad is None:
            return self
        angle = np.asarray(angle_rad)
        return replace(self, azimuth_rad=self.azimuth_rad + (angle[:, None, None] if angle.ndim else angle))


def stack_paths(epoch: Epoch, carrier_hz: float) -> PathTable:
    """The paths of an epoch in one table (K, M)."""
    return pool_paths([epoch], [carrier_hz]).of_run(0)


def pool_paths(epochs: Sequence[Epoch], carriers_hz: Sequence[float]) -> PathTable:
    """The paths of an epoch of each of B runs in one table (B, K, M), padded to the most paths.

    All epochs have the same number of anchors and the same knowledge of the heading.
    """
    every = [paths for epoch in epochs for paths in epoch.paths]
    counts = np.array([len(paths) for paths in every]).reshape(len(epochs), -1)
    valid = np.arange(max(int(counts.max(initial=0)), 1)) < counts[..., None]

    def table(columns: list[Array | None], empty: float) -> Array:
        result = np.full(valid.shape, empty)
        given = [np.full(len(p), empty) if c is None else c for c, p in zip(columns, every, strict=True)]
        result[valid] = np.concatenate(given)
        return result

    length = table([paths.delay_s for paths in every], 1.0 / SPEED_OF_LIGHT_M_S) * SPEED_OF_LIGHT_M_S
    std = table([paths.delay_std_s for paths in every], 1.0 / SPEED_OF_LIGHT_M_S) * SPEED_OF_LIGHT_M_S
    loss = np.full(valid.shape, np.nan)
    if any(paths.gain_db is not None for paths in every):
        carrier = np.broadcast_to(np.asarray(carriers_hz)[:, None, None], valid.shape)
        gain = table([paths.gain_db for paths in every], np.nan)
        loss[valid] = -gain[valid] - free_space_loss_db(length[valid], carrier[valid])
    held = epochs[0].heading_held
    if all(paths.azimuth_rad is None for paths in every):
        return PathTable(length, std, loss, valid, heading_held=held)
    azimuth = table([paths.azimuth_rad for paths in every], 0.0)
    azimuth_std = table([paths.azimuth_std_rad for paths in every], np.inf)
    return PathTable(length, std, loss, valid, azimuth, azimuth_std, held)
