"""The paths of an epoch as padded arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import Epoch
from estimator.waveform import free_space_loss_db

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

    def _each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> PathTable:
        columns: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        changed = {name: change(each) for name, each in columns.items() if isinstance(each, np.ndarray)}
        return PathTable(**{**columns, **changed})

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


def pool_paths(tables: Sequence[PathTable]) -> PathTable:
    """Tables (K, M) of several runs as one (B, K, M), padded to the most paths.

    All of them or none have azimuths, with the same knowledge of the heading.
    """
    most = max(table.length_m.shape[1] for table in tables)

    def stacked(name: str, empty: float) -> NDArray[Any]:
        columns = [getattr(table, name) for table in tables]
        result = np.full((len(tables), len(columns[0]), most), empty, dtype=columns[0].dtype)
        for row, column in zip(result, columns, strict=True):
            row[:, : column.shape[1]] = column
        return result

    first = tables[0]
    return PathTable(
        stacked("length_m", 1.0),
        stacked("std_m", 1.0),
        stacked("excess_loss_db", np.nan),
        stacked("valid", 0.0),
        None if first.azimuth_rad is None else stacked("azimuth_rad", 0.0),
        None if first.azimuth_std_rad is None else stacked("azimuth_std_rad", np.inf),
        first.heading_held,
    )
