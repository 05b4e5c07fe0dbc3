"""What a smoothed run tells of the map as a whole, and the evidence for it: see :class:`JointMap`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.joint_map import JointMap
from estimator.measurements import MeasurementSet
from estimator.slam.models.extents import bounce_along_wall
from estimator.slam.models.path_lengths import predict_paths
from estimator.slam.models.state_vector import Layout
from estimator.slam.smoothing.factors import PathFactors, Problem, Trajectory
from estimator.slam.smoothing.smoother import Smoothed, placed

__all__ = ["feature_walls", "joint_map"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_AGENT_ENTRIES = 4  # x, y, vx, vy head what is placed; the rotation ends it


def joint_map(problem: Problem, smoothed: Smoothed, measurements: MeasurementSet, order: Index) -> JointMap:
    """Joint covariance, heights, clocks, extents and associated paths of a smoothed run.

    Parameters
    ----------
    problem : Problem
        The factors that were smoothed.
    smoothed : Smoothed
        The run.
    measurements : MeasurementSet
        What was measured.
    order : ndarray of int64, shape (L,)
        Slot of each wall of the result.

    Returns
    -------
    JointMap
    """
    layout, at = problem.layout, smoothed.trajectory
    _, covariance = placed(problem, at, smoothed.marginals, -1)
    anchors = _AGENT_ENTRIES + np.arange(2 * layout.anchors)
    walls = anchors.size + _AGENT_ENTRIES + (2 * order[:, None] + np.arange(2)).ravel()
    among = np.concatenate([anchors, walls])
    still = _still_variances(problem, smoothed)
    heights = [layout.height2(k) for k in range(layout.anchors)]
    biases = [layout.bias(k) for k in range(layout.anchors)]
    factors = problem.paths
    column = np.empty(layout.slots, dtype=np.int64)
    column[order] = np.arange(layout.slots)
    bounced = feature_walls(layout, factors.feature)
    predicted = predict_paths(at.states(), layout).length_m[factors.epoch, factors.anchor, factors.feature]
    return JointMap(
        carrier_hz=measurements.carrier_hz,
        anchor_height2_m2=at.still[heights],
        anchor_height2_variance_m4=still[heights],
        anchor_bias_m=at.still[biases],
        anchor_bias_variance_m2=still[biases],
        map_covariance_m2=covariance[np.ix_(among, among)],
        wall_extent_m=_extents(layout, at, factors)[order],
        path_epoch=factors.epoch,
        path_anchor=factors.anchor,
        path_number=factors.number,
        path_walls=np.where(bounced < 0, -1, column[bounced]),
        path_length_m=factors.length_m,
        path_std_m=factors.std_m,
        path_gain_db=_gains(measurements, factors),
        path_residual_m=factors.length_m - predicted,
    )


def feature_walls(layout: Layout, feature: Index) -> Index:
    """Slots (N, 2) of the walls that features (N,) bounce off, from the anchor on; -1 beyond the last."""
    walls = np.full((len(feature), 2), -1, dtype=np.int64)
    single = (feature > 0) & (feature <= layout.slots)
    walls[single, 0] = feature[single] - 1
    double = feature > layout.slots
    pair = feature[double] - 1 - layout.slots
    walls[double] = np.stack([pair // layout.slots, pair % layout.slots], axis=-1)
    return walls


def _still_variances(problem: Problem, smoothed: Smoothed) -> Array:
    """Variances (n,) of what stands still."""
    basis, _ = problem.basis()
    return np.asarray(np.einsum("iq,qr,ir->i", basis, smoothed.marginals.border, basis))


def _gains(measurements: MeasurementSet, factors: PathFactors) -> Array:
    """Gains (N,) of the paths that became factors, dB; NaN where they are unknown."""
    gains = np.full(len(factors.epoch), np.nan)
    for i, (t, k, j) in enumerate(zip(factors.epoch, factors.anchor, factors.number, strict=True)):
        gain = measurements.epochs[t].paths[k].gain_db
        if gain is not None and j >= 0:
            gains[i] = gain[j]
    return gains


def _extents(layout: Layout, at: Trajectory, factors: PathFactors) -> Array:
    """Where along each wall (L, 2) single bounces were detected, metres; NaN where none was."""
    extent = np.full((layout.slots, 2), np.nan)
    for slot in range(layout.slots):
        vx, vy = at.still[layout.wall(slot)]
        mine = factors.feature == 1 + slot
        along = []
        for t, k in zip(factors.epoch[mine], factors.anchor[mine], strict=True):
            (px, py), (ax, ay) = at.agent[t, :2], at.still[layout.anchor_xy(k)]
            along.append(bounce_along_wall(px, py, ax, ay, vx, vy))
        if along:
            extent[slot] = min(along), max(along)
    return extent
