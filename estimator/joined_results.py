"""The results of successive stretches of a run, joined to the result of the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.result import EPOCH_SHAPES, SlamResult

__all__ = ["join_results"]

_IDS = {
    "wall": "wall_id",
    "candidate_wall": "candidate_wall_id",
}  # of axes that differ from stretch to stretch


def join_results(results: Sequence[SlamResult]) -> SlamResult:
    """Join results of stretches that follow each other, none of them smoothed.

    Parameters
    ----------
    results : sequence of SlamResult
        At least one, in their order; method, engine, seed, anchors and settings are those of the first.

    Returns
    -------
    SlamResult
        What one run over all their epochs would have given: a wall's column has its identity, and is empty
        where a stretch does not know it.
    """
    if len(results) == 1:
        return results[0]
    ids = {
        axis: np.unique(np.concatenate([getattr(one, name) for one in results]))
        for axis, name in _IDS.items()
    }
    sizes = {axis: len(known) for axis, known in ids.items()}
    sizes["candidate"] = max(one.candidate_weight.shape[1] for one in results)
    columns: dict[str, Any] = {_IDS[axis]: known.astype(np.int64) for axis, known in ids.items()}
    for name, axes in EPOCH_SHAPES.items():
        if getattr(results[0], name) is None:  # an engine that does not tell
            continue
        stretches = []
        for one in results:
            values = getattr(one, name)
            for place, axis in enumerate(axes):
                if axis in sizes:
                    own = np.arange(values.shape[place])
                    if axis in ids:
                        own = np.searchsorted(ids[axis], getattr(one, _IDS[axis]))
                    values = _placed(values, place, own, sizes[axis])
            stretches.append(values)
        columns[name] = np.concatenate(stretches)
    return replace(results[0], **columns)


def _placed(values: NDArray[Any], axis: int, columns: NDArray[np.int64], count: int) -> NDArray[Any]:
    """Values whose entries along an axis go to the given columns of ``count``; the others are empty."""
    shape = list(values.shape)
    shape[axis] = count
    whole = np.zeros(shape, dtype=bool) if values.dtype == np.bool_ else np.full(shape, np.nan)
    whole[(slice(None),) * axis + (columns,)] = values
    return whole
