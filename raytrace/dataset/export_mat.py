"""A dataset for MATLAB and GNU Octave: one ``.mat`` file for each shard.

Files are of MATLAB's version 5, which both read without further software. Pairs
``_re``, ``_im`` become complex arrays; axes keep their order, so MATLAB's
``cfr(epoch, anchor, antenna, tone)`` is what the conventions say (counted from 1).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.io import savemat

from estimator.dataset import KINDS, MANIFEST, Dataset, publish, temporary_name, write_text
from estimator.errors import InputError

__all__ = ["export_mat"]

# MATLAB's version 5 counts the bytes of a variable in 32 bits, and scipy refuses half of that.
_MOST_BYTES = 2**31 - 1
_HEAD = b"MATLAB 5.0 MAT-file, written by hapslam".ljust(116)


def export_mat(dataset: Dataset, out: Path) -> None:
    """Write every shard of a dataset as a ``.mat`` file, and the manifest beside them.

    Equal datasets give equal bytes; no more than a shard is in memory.

    Parameters
    ----------
    dataset : Dataset
        What to export.
    out : Path
        Folder to write into, which exists.

    Raises
    ------
    InputError
        If a variable is too large for the format.
    FileFormatError
        If a shard is missing or changed.
    """
    for kind in KINDS:
        names = [entry["file"] for entry in dataset.manifest["shards"] if entry["kind"] == kind]
        for name, shard in zip(names, dataset.shards(kind), strict=True):
            _save(_variables(shard), out / Path(name).with_suffix(".mat"))
    write_text((dataset.path / MANIFEST).read_text(encoding="utf-8"), out / MANIFEST)


def _variables(shard: xr.Dataset) -> dict[str, Any]:
    """Arrays of a shard by name, those of real and imaginary parts as one; attributes by theirs."""
    arrays: dict[str, Any] = {str(name): values.values for name, values in shard.variables.items()}
    for name in [name for name in arrays if name.endswith("_re")]:
        real, imaginary = arrays.pop(name), arrays.pop(f"{name[:-3]}_im")
        arrays[name[:-3]] = real + 1j * imaginary
    for name, values in arrays.items():
        if values.dtype.kind in "OUT":
            arrays[name] = np.array([str(text) for text in values], dtype=object)
        if values.nbytes > _MOST_BYTES:
            raise InputError(
                f"{name}: expected at most {_MOST_BYTES} bytes for a .mat file, got {values.nbytes}; "
                "trace with fewer epochs in a shard"
            )
    return {**arrays, **{str(name): value for name, value in shard.attrs.items()}}


def _save(variables: dict[str, Any], path: Path) -> None:
    temporary = temporary_name(path)
    try:
        savemat(str(temporary), variables, appendmat=False, long_field_names=True, oned_as="column")
        with temporary.open("r+b") as stream:
            stream.write(_HEAD)  # in place of the time of writing
        publish(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
