"""Some epochs of a dataset, whatever its size: only what is asked for is read.

A dataset can be larger than memory. :meth:`estimator.dataset.Dataset.shards` reads
it shard by shard; :func:`read_window` reads a stretch of epochs, over the borders of
shards, and of it the variables that are wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from estimator.dataset import Dataset
from estimator.errors import FileFormatError, InputError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["read_window"]

# How a path that is not there is written; shards have as many paths as their fullest channel.
_NO_PATH = {"amplitude_re": 0.0, "amplitude_im": 0.0, "path_valid": 0, "order": 0, "walls": -1}


def read_window(
    dataset: Dataset, kind: str, first: int, stop: int, variables: Sequence[str] | None = None
) -> xr.Dataset:
    """Read epochs ``first`` to ``stop - 1`` of the passive channels or the paths.

    Parameters
    ----------
    dataset : Dataset
        An opened dataset.
    kind : str
        ``passive`` or ``paths``.
    first, stop : int
        The epochs, ``0 <= first < stop <= epochs``.
    variables : sequence of str, optional
        Names of the variables to read; by default all.

    Returns
    -------
    xarray.Dataset
        In memory, dimension ``epoch`` of length ``stop - first``. The sizes of the
        files are compared with the manifest, their hashes are not.

    Raises
    ------
    InputError
        If the epochs or a variable are not in the dataset.
    FileFormatError
        If a shard is missing, truncated or unreadable, or the manifest does not say which epochs
        it holds.
    """
    if kind not in ("passive", "paths"):
        raise InputError(f"kind: expected 'passive' or 'paths', got {kind!r}")
    total = int(dataset.manifest["epochs"])
    if not 0 <= first < stop <= total:
        raise InputError(f"epochs: expected 0 <= first < stop <= {total}, got first {first}, stop {stop}")
    import xarray as xr

    from estimator.hdf5_guard import check_hdf5

    parts = []
    for entry in dataset.manifest["shards"]:
        if entry["kind"] != kind:
            continue
        if "epochs" not in entry:
            raise FileFormatError(f"{dataset.path}: expected the epochs of {entry['file']} in the manifest")
        low, high = entry["epochs"]
        if low < stop and high > first:
            here = slice(max(first, low) - low, min(stop, high) - low)
            try:
                file = dataset.file(entry)
                check_hdf5(file)
                with xr.open_dataset(file, engine="h5netcdf") as shard:
                    picked = shard if variables is None else shard[list(variables)]
                    parts.append(picked.isel(epoch=here).load())
            except KeyError as error:
                raise InputError(
                    f"variables: expected some of {', '.join(map(str, shard.data_vars))}, got {error}"
                ) from error
            except OSError as error:
                raise FileFormatError(f"{entry['file']}: expected netCDF-4, could not read it") from error
    return _joined(parts)


def _joined(parts: list[xr.Dataset]) -> xr.Dataset:
    """Successive epochs as one dataset; channels with fewer paths are filled up."""
    import xarray as xr

    paths = max((part.sizes.get("path", 0) for part in parts), default=0)
    filled = [
        part.pad(
            path=(0, paths - part.sizes["path"]),
            constant_values={name: _NO_PATH.get(str(name), np.nan) for name in part.data_vars},
        )
        if part.sizes.get("path", paths) < paths
        else part
        for part in parts
    ]
    if len(filled) == 1:
        return filled[0]
    return xr.concat(
        filled, "epoch", data_vars="minimal", coords="minimal", compat="override", join="override"
    )
