"""Whether a wall that nobody mapped was heard after all: unassigned paths at its lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.geometry import vrp_of_line
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.specular import specular_paths
from estimator.twin.sightings import joint_of
from estimator.twin.stretches import Closing, Stretch

__all__ = ["support", "supported"]

Array = NDArray[np.float64]


def supported(
    wall: Stretch,
    others: list[Stretch],
    result: SlamResult,
    measurements: MeasurementSet,
    closing: Closing,
) -> bool:
    """Whether what was heard allows an assumed wall; True where it would not have been heard.

    Parameters
    ----------
    wall : Stretch
        The assumed wall.
    others : list of Stretch
        The walls that hide it.
    result, measurements
        The run.
    closing : Closing
        What is near, and how much support is needed.
    """
    expected, heard = support(wall, others, result, measurements, closing.near_m)
    return expected < closing.least_expected or heard >= closing.least_support * expected


def support(
    wall: Stretch, others: list[Stretch], result: SlamResult, measurements: MeasurementSet, near_m: float
) -> tuple[int, int]:
    """Single bounces that a wall would have given, and those of them near which a path was measured."""
    joint = joint_of(result)
    start = np.array([wall.ends_m[0], *(other.ends_m[0] for other in others)])
    end = np.array([wall.ends_m[1], *(other.ends_m[1] for other in others)])
    vrp = vrp_of_line(start[:1], end[:1])
    if not np.isfinite(vrp).all():
        return 0, 0
    anchors = np.where(result.anchor_valid[-1][:, None], result.anchor_mean_m[-1], 1e4)
    paths = specular_paths(start, end, anchors, result.agent_mean[:, :2], 1)
    own = paths.walls.index((0,))
    visible = paths.visible[:, :, own] & result.anchor_valid[-1]
    length = np.sqrt(paths.length_m[:, :, own] ** 2 + np.maximum(joint.anchor_height2_m2, 0.0))
    length = length + joint.anchor_bias_m
    taken = {
        (int(t), int(k), int(n))
        for t, k, n in zip(joint.path_epoch, joint.path_anchor, joint.path_number, strict=True)
    }
    heard = 0
    for t, k in zip(*np.nonzero(visible), strict=True):
        measured = measurements.epochs[t].paths[k].range_m
        free = [n for n in range(len(measured)) if (int(t), int(k), n) not in taken]
        heard += bool(np.any(np.abs(measured[free] - length[t, k]) < near_m))
    return int(visible.sum()), heard
