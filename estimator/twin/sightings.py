"""What a run heard and what it did not: each unfolded path is heard, silent, or tells nothing.

A path that was given to a feature is heard. One that lines without ends would give, that would have been
strong enough, and near whose length nothing was measured, is silent: some end or obstacle is the
reason. The rest (too weak, or merged with a neighbour that the bandwidth does not resolve) tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError, InputError
from estimator.geometry import mirror
from estimator.joint_map import JointMap
from estimator.measurements import MeasurementSet
from estimator.result import SlamResult
from estimator.twin.unfolding import Unfolded, unfold
from estimator.waveform import free_space_loss_db

__all__ = ["Hearing", "Sightings", "joint_of", "sightings"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Hearing:
    """What counts as heard, and as silent.

    Parameters
    ----------
    resolution_m : float
        Paths whose lengths differ by less may be one measured path: the bandwidth's resolution, c / B, is
        .75 m for 400 MHz.
    margin_sigma, margin_m : float
        A measured path is near a predicted length within so many of its standard deviations and this,
        metres: errors
        of the map.
    bounce_loss_db : float
        Loss that a bounce is expected to cost at most, off walls whose bounces were not heard: building
        materials cost 5 to 15 dB.
    least_bounces : int
        Bounces from which a wall's own losses are believed: the 95th percentile.
    least_share : float
        A path is strong enough if this share of an anchor's measured paths were weaker than it is expected.
    dynamic_range_db : float
        A path this much weaker than the strongest of its epoch may be missed: channel estimators pass over
        what
        drowns in the others' side lobes.
    stride : int
        Every so many epochs are looked at; neighbours tell the same.
    """

    resolution_m: float = 0.75
    margin_sigma: float = 4.0
    margin_m: float = 0.1
    bounce_loss_db: float = 12.0
    least_bounces: int = 5
    least_share: float = 0.02
    dynamic_range_db: float = 29.0
    stride: int = 1

    def __post_init__(self) -> None:
        for name in ("resolution_m", "margin_sigma", "margin_m", "bounce_loss_db", "dynamic_range_db"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {getattr(self, name)}")
        if not 0.0 <= self.least_share < 1.0 or self.stride < 1:
            raise ConfigurationError(
                f"least_share, stride: expected a share below 1 and at least 1, "
                f"got {self.least_share} and {self.stride}"
            )


@dataclass(frozen=True, eq=False)
class Sightings:
    """Unfolded paths of a run, and which of them were heard.

    Parameters
    ----------
    epoch : ndarray of int64, shape (T,)
        Rows of the result that were looked at.
    unfolded : Unfolded
        Their candidate paths.
    heard, silent : ndarray of bool, shape (T, K, F)
        See the module; never both.
    weight : ndarray, shape (T, K, F)
        How far what was heard belongs to its feature: 1, less where others would be as long.
    length_m : ndarray, shape (T, K, F)
        Slanted lengths, heights and clock biases included.
    flash_row, flash_wall : ndarray of int64, shape (N,)
        Positions from which a sweep saw a wall at right angles, and the wall.
    """

    epoch: NDArray[np.int64]
    unfolded: Unfolded
    heard: Mask
    silent: Mask
    weight: Array
    length_m: Array
    flash_row: NDArray[np.int64]
    flash_wall: NDArray[np.int64]


def joint_of(result: SlamResult) -> JointMap:
    """The joint map of a result; raises InputError if it is not a smoothed one."""
    if result.joint is None:
        raise InputError("result: expected a smoothed run (hapslam slam --smooth), got one without joint map")
    return result.joint


def sightings(result: SlamResult, measurements: MeasurementSet, config: Hearing | None = None) -> Sightings:
    """Sort the unfolded paths of a smoothed run.

    Parameters
    ----------
    result : SlamResult
        A smoothed run.
    measurements : MeasurementSet
        What it was made of.
    config : Hearing, optional
        What counts.

    Raises
    ------
    InputError
        If the result is not a smoothed one, or the measurements are another run's.
    """
    joint, config = joint_of(result), config or Hearing()
    if len(measurements.epochs) != len(result.epoch) or measurements.anchors != result.anchors:
        raise InputError(
            f"measurements: expected {len(result.epoch)} epochs of the result's anchors, "
            f"got {len(measurements.epochs)} of {measurements.anchors}"
        )
    rows = np.arange(0, len(result.epoch), config.stride)
    located = result.anchor_valid[-1]
    anchors = np.where(located[:, None], result.anchor_mean_m[-1], 0.0)
    paths = unfold(result.wall_mean_m[-1], anchors, result.agent_mean[rows, :2])
    height2 = np.maximum(joint.anchor_height2_m2, 0.0)
    length = np.sqrt(paths.length_m**2 + height2[:, None]) + joint.anchor_bias_m[:, None]
    heard = _heard(joint, paths, len(result.epoch))[rows] & paths.possible
    usable = paths.possible & located[:, None]
    near, strong = np.zeros(usable.shape, dtype=bool), np.zeros(usable.shape, dtype=bool)
    bounces = np.sum(paths.walls >= 0, axis=1)
    expected = (
        -free_space_loss_db(np.maximum(length, 1.0), joint.carrier_hz) - config.bounce_loss_db * bounces
    )
    for k in range(len(anchors)):
        least = _weakest(measurements, k, config.least_share)
        strong[:, k] = expected[:, k] > least
        for i, t in enumerate(rows):
            epoch = measurements.epochs[t]
            if not epoch.was_asked[k]:
                usable[i, k] = False
                continue
            measured, gain = epoch.paths[k].range_m, epoch.paths[k].gain_db
            if gain is not None and len(gain):
                strong[i, k] &= expected[i, k] > gain.max() - config.dynamic_range_db
            if measured.size:
                reach = config.resolution_m + config.margin_m
                gap = np.abs(length[i, k][:, None] - measured)
                near[i, k] = np.any(
                    gap < np.maximum(reach, config.margin_sigma * epoch.paths[k].range_std_m), axis=1
                )
    silent = usable & strong & ~near & ~heard
    flashes = _flashes(result, measurements, rows, config)
    return Sightings(rows, paths, heard & usable, silent, _weights(length, usable, config), length, *flashes)


def _flashes(
    result: SlamResult, measurements: MeasurementSet, rows: NDArray[np.int64], config: Hearing
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and walls (N,) of what sweeps saw: each flash is that of the nearest wall within the margin."""
    vrps, found = result.wall_mean_m[-1], []
    for i, t in enumerate(rows):
        epoch = measurements.epochs[t]
        sweep = (*measurements.walls, *epoch.sweep) if t == 0 else epoch.sweep
        if not sweep or not epoch.heading_held:
            continue
        agent = result.agent_mean[t, :2]
        images = mirror(agent, vrps) - agent
        for flash in sweep:
            gap = images - flash.mean_m
            spread = flash.covariance_m2 + (2.0 * config.margin_m) ** 2 * np.eye(2)
            square = np.sum(gap * np.linalg.solve(spread, gap.T).T, axis=1)
            if square.min() < config.margin_sigma**2:
                found.append((i, int(square.argmin())))
    table = np.array(found, dtype=np.int64).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _heard(joint: JointMap, paths: Unfolded, epochs: int) -> Mask:
    """Which features (epochs, K, F) have a path."""
    number = {(int(a), int(b)): f for f, (a, b) in enumerate(paths.walls)}
    heard = np.zeros((epochs, *paths.possible.shape[1:]), dtype=bool)
    feature = np.array([number.get((int(a), int(b)), -1) for a, b in joint.path_walls], dtype=np.int64)
    known = feature >= 0
    heard[joint.path_epoch[known], joint.path_anchor[known], feature[known]] = True
    return heard


def _wall_losses(joint: JointMap, walls: int, config: Hearing) -> Array:
    """What a bounce off each wall costs at most (L,), dB."""
    losses = np.full(walls, config.bounce_loss_db)
    single = (joint.path_walls[:, 0] >= 0) & (joint.path_walls[:, 1] < 0) & np.isfinite(joint.path_gain_db)
    for wall in range(walls):
        mine = single & (joint.path_walls[:, 0] == wall)
        if mine.sum() >= config.least_bounces:
            loss = -joint.path_gain_db[mine] - free_space_loss_db(joint.path_length_m[mine], joint.carrier_hz)
            losses[wall] = np.quantile(loss, 0.95)
    return losses


def _weakest(measurements: MeasurementSet, anchor: int, share: float) -> float:
    """Gain that a share of an anchor's measured paths fall short of, dB; minus infinity if none is known."""
    gains = [epoch.paths[anchor].gain_db for epoch in measurements.epochs]
    known = np.concatenate([np.zeros(0), *(gain for gain in gains if gain is not None)])
    return float(np.quantile(known, share)) if known.size else -np.inf


def _weights(length: Array, usable: Mask, config: Hearing) -> Array:
    """One over the number of features (T, K, F) that would be about as long."""
    weight = np.ones(length.shape)
    for f in range(length.shape[2]):
        alike = usable & (np.abs(length - length[:, :, f : f + 1]) < config.margin_m)
        weight[:, :, f] = 1.0 / np.maximum(alike.sum(axis=2), 1)
    return weight
