"""What each wall took from the paths that bounced off it: samples for telling its material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.joint_map import JointMap
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.twin.sightings import joint_of
from estimator.twin.unfolding import unfold
from estimator.waveform import free_space_loss_db

__all__ = ["BounceSamples", "bounce_samples", "gain_noise_db", "gain_offsets"]

Array = NDArray[np.float64]

_NEIGHBOUR_M = np.array([0.3, 0.75, 1.5])
_NOISE_DB = np.array([3.0, 0.9, 0.1, 0.05])
"""Noise of a gain by the distance of the next measured path: below 1, 2.5, 5 ns and above, at 400 MHz."""


@dataclass(frozen=True, eq=False)
class BounceSamples:
    """Single bounces, N of them.

    Parameters
    ----------
    wall, anchor : ndarray of int64, shape (N,)
        Column of the result's wall, and anchor.
    vertex_m : ndarray, shape (N, 3, 3)
        Anchor, bounce and agent in space: the agent at height 0, anchors above it.
    loss_db : ndarray, shape (N,)
        Loss beyond free space, the anchor's own offset taken off.
    noise_db : ndarray, shape (N,)
        Standard deviation of the loss.
    """

    wall: NDArray[np.int64]
    anchor: NDArray[np.int64]
    vertex_m: Array
    loss_db: Array
    noise_db: Array


def gain_noise_db(measurements: MeasurementSet, epoch: int, anchor: int, number: int) -> float:
    """Standard deviation of a measured path's gain, dB, by its distance from the next one."""
    lengths = measurements.epochs[epoch].paths[anchor].range_m
    gap = np.abs(np.delete(lengths, number) - lengths[number]).min(initial=np.inf)
    return float(_NOISE_DB[np.searchsorted(_NEIGHBOUR_M, gap, side="right")])


def gain_offsets(result: SlamResult, measurements: MeasurementSet) -> tuple[Array, Array]:
    """Offset (K,) of each anchor's gains against free space, from its lines of sight, and its deviation, dB.

    Zero and infinity for anchors without a clean line of sight.
    """
    joint = joint_of(result)
    offset, std = np.zeros(len(result.anchors)), np.full(len(result.anchors), np.inf)
    direct = (joint.path_walls[:, 0] < 0) & np.isfinite(joint.path_gain_db)
    for k in range(len(result.anchors)):
        mine = np.flatnonzero(direct & (joint.path_anchor == k))
        noise = np.array([_noise(joint, measurements, int(i)) for i in mine])
        clean = mine[noise <= _NOISE_DB[2]] if len(mine) else mine
        if len(clean):
            length = joint.path_length_m[clean] - joint.anchor_bias_m[k]
            loss = joint.path_gain_db[clean] + free_space_loss_db(length, joint.carrier_hz)
            offset[k] = np.median(loss)
            spread = 1.4826 * float(np.median(np.abs(loss - offset[k])))
            std[k] = max(spread, _NOISE_DB[3]) / np.sqrt(len(clean))
    return offset, std


def bounce_samples(result: SlamResult, measurements: MeasurementSet, offset_db: Array) -> BounceSamples:
    """The clean single bounces of a smoothed run.

    Parameters
    ----------
    result : SlamResult
        A smoothed run.
    measurements : MeasurementSet
        What it was made of.
    offset_db : ndarray, shape (K,)
        From :func:`gain_offsets`.
    """
    joint = joint_of(result)
    single = np.flatnonzero(
        (joint.path_walls[:, 0] >= 0) & (joint.path_walls[:, 1] < 0) & np.isfinite(joint.path_gain_db)
    )
    wall, anchor, epoch = joint.path_walls[single, 0], joint.path_anchor[single], joint.path_epoch[single]
    paths = unfold(result.wall_mean_m[-1], result.anchor_mean_m[-1], result.agent_mean[:, :2], order=1)
    flat = paths.vertex_m[epoch, anchor, 1 + wall][:, :3]
    height = np.sqrt(np.maximum(joint.anchor_height2_m2, 0.0))[anchor]
    first = np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1)
    whole = first + np.linalg.norm(flat[:, 2] - flat[:, 1], axis=1)
    vertex = np.zeros((len(single), 3, 3))
    vertex[..., :2] = flat
    vertex[:, 0, 2] = height
    vertex[:, 1, 2] = height * (1.0 - first / np.maximum(whole, 1e-9))
    length = joint.path_length_m[single] - joint.anchor_bias_m[anchor]
    loss = -joint.path_gain_db[single] - free_space_loss_db(length, joint.carrier_hz) + offset_db[anchor]
    noise = np.array([_noise(joint, measurements, int(i)) for i in single])
    usable = np.isfinite(vertex).all(axis=(1, 2)) & paths.possible[epoch, anchor, 1 + wall]
    return BounceSamples(
        wall[usable],
        anchor[usable],
        vertex[usable],
        loss[usable],
        noise[usable] if len(noise) else np.zeros(0),
    )


def _noise(joint: JointMap, measurements: MeasurementSet, i: int) -> float:
    return gain_noise_db(
        measurements, int(joint.path_epoch[i]), int(joint.path_anchor[i]), int(joint.path_number[i])
    )
