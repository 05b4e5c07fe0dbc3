"""Channels of a dataset, and its positions in the frame of a plan that was estimated in the same rooms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.dataset import Dataset
from estimator.errors import FileFormatError
from estimator.geometry import rotate
from raytrace.dataset.shards import stored_paths, stored_plan
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.paths import PathList, PathSet

__all__ = ["HeldOut", "held_out"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Noiseless channels that a prediction is held against.

    Parameters
    ----------
    plan : FloorPlan
        The true plan.
    track_m : ndarray, shape (T, 3)
        Positions in it.
    paths : PathSet
        The paths.
    """

    plan: FloorPlan
    track_m: Array
    paths: PathSet

    def seen_from(self, start_m: Array, heading_rad: float) -> Array:
        """Positions (T, 2) in the frame with this origin and direction of the x axis in the true plan."""
        return np.asarray(rotate(self.track_m[:, :2] - start_m[:2], -heading_rad))


def held_out(dataset: Dataset) -> HeldOut:
    """The channels of a dataset.

    Raises
    ------
    FileFormatError
        If it has no paths or no truth.
    """
    truth = dataset.truth()
    plan = stored_plan(truth)
    parts, epochs = [], 0
    for shard in dataset.shards("paths"):
        paths = stored_paths(shard, float(truth.attrs["heading_rad"]))
        flat = paths.flat()
        parts.append(_later(flat, epochs))
        epochs += len(paths.valid)
    track = truth["track_m"].values
    if not parts or epochs != len(track):
        raise FileFormatError(
            f"{dataset.path}: expected the paths of {len(track)} epochs, got those of {epochs}"
        )
    return HeldOut(plan, track, PathSet.build(PathList.concatenate(parts), epochs, len(plan.anchors)))


def _later(paths: PathList, epochs: int) -> PathList:
    return PathList(**{**vars(paths), "epoch": paths.epoch + epochs})
