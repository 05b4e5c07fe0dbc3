"""The few marked entries of wide arrays, packed side by side."""

from __future__ import annotations

from math import prod

import numpy as np
from numpy.typing import NDArray

__all__ = ["packed"]


def packed(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Where the marked entries of the last axis are, in order.

    Parameters
    ----------
    mask : ndarray of bool, shape (..., F)
        The entries.

    Returns
    -------
    index : ndarray of int64, shape (..., C)
        Their places, C as many as the fullest line has; 0 where a line has fewer.
    keep : ndarray of bool, shape (..., C)
        Which of them are entries.
    """
    lines = mask.reshape(prod(mask.shape[:-1]), mask.shape[-1])
    count = lines.sum(axis=1)
    most = int(count.max(initial=0))
    keep = np.arange(most) < count[:, None]
    index = np.zeros(keep.shape, dtype=np.int64)
    index[keep] = np.nonzero(lines)[1]
    shape = (*mask.shape[:-1], most)
    return index.reshape(shape), keep.reshape(shape)
