"""What each wall took from the paths that bounced off it: samples for telling its material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.twin.sightings import Sightings, joint_of
from estimator.twin.unfolding import unfold
from estimator.waveform import free_space_loss_db

__all__ = ["BounceSamples", "bounce_samples", "gain_noise_db", "gain_offsets", "gaps_to_neighbours"]

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


def gain_noise_db(gap_m: Array) -> Array:
    """Standard deviation of the gains of paths by how far the next path is, dB.

    Parameters
    ----------
    gap_m : ndarray
        Difference of length to the next path that was measured, or that the map expects: two that are
        not resolved are measured as one.
    """
    return np.asarray(_NOISE_DB[np.searchsorted(_NEIGHBOUR_M, gap_m, side="right")])


def gaps_to_neighbours(
    result: SlamResult, measurements: MeasurementSet, sights: Sightings, expected: NDArray[np.bool_]
) -> Array:
    """Difference of length (N,) of each associated path to the next, 0 where nobody looked.

    Parameters
    ----------
    result, measurements
        The run.
    sights : Sightings
        Where it was looked at.
    expected : ndarray of bool, shape (T, K, F)
        Paths that its walls would give there.
    """
    joint = joint_of(result)
    gap, row = np.zeros(len(joint.path_epoch)), np.full(len(result.epoch), -1)
    row[sights.epoch] = np.arange(len(sights.epoch))
    number = {(int(a), int(b)): f for f, (a, b) in enumerate(sights.unfolded.walls)}
    for i in range(len(gap)):
        t, k = int(joint.path_epoch[i]), int(joint.path_anchor[i])
        feature = number.get((int(joint.path_walls[i, 0]), int(joint.path_walls[i, 1])), -1)
        if row[t] < 0 or feature < 0:
            continue
        others = expected[row[t], k].copy()
        others[feature] = False
        lengths = sights.length_m[row[t], k]
        measured = np.delete(measurements.epochs[t].paths[k].range_m, joint.path_number[i])
        gap[i] = min(
            np.abs(measured - joint.path_length_m[i]).min(initial=np.inf),
            np.abs(lengths[others] - lengths[feature]).min(initial=np.inf),
        )
    return gap


def gain_offsets(result: SlamResult, noise_db: Array, prior_std_db: float) -> tuple[Array, Array]:
    """Offset (K,) of each anchor's gains against free space, from its lines of sight, and its deviation, dB.

    Parameters
    ----------
    result : SlamResult
        A smoothed run.
    noise_db : ndarray, shape (N,)
        Standard deviation of the gain of each associated path.
    prior_std_db : float
        What is believed of offsets beforehand; 0 where gains are calibrated: then they are 0.
    """
    joint = joint_of(result)
    offset, std = np.zeros(len(result.anchors)), np.full(len(result.anchors), prior_std_db)
    if prior_std_db == 0.0:
        return offset, std
    direct = (joint.path_walls[:, 0] < 0) & np.isfinite(joint.path_gain_db) & (noise_db <= _NOISE_DB[2])
    for k in range(len(result.anchors)):
        clean = direct & (joint.path_anchor == k)
        if clean.any():
            length = joint.path_length_m[clean] - joint.anchor_bias_m[k]
            loss = joint.path_gain_db[clean] + free_space_loss_db(length, joint.carrier_hz)
            offset[k] = np.median(loss)
            spread = 1.4826 * float(np.median(np.abs(loss - offset[k])))
            std[k] = max(spread, _NOISE_DB[3]) / np.sqrt(clean.sum())
    return offset, std


def bounce_samples(result: SlamResult, noise_db: Array, offset_db: Array) -> BounceSamples:
    """The single bounces of a smoothed run.

    Parameters
    ----------
    result : SlamResult
        A smoothed run.
    noise_db : ndarray, shape (N,)
        Standard deviation of the gain of each associated path.
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
    usable = np.isfinite(vertex).all(axis=(1, 2)) & paths.possible[epoch, anchor, 1 + wall]
    return BounceSamples(wall[usable], anchor[usable], vertex[usable], loss[usable], noise_db[single][usable])
