"""The limit of a building: what the best filter with known associations would make of what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from estimator.measurements import MeasurementSet
from estimator.slam.bounds.posterior import posterior_bounds
from estimator.slam.bounds.scenario import Scenario, Sensing
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.run import config_for

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["building_scenario", "position_limit", "sensing_of"]

Array = NDArray[np.float64]


def position_limit(measurements: MeasurementSet, truth: xr.Dataset, order: int = 2) -> Array:
    """Mean distance from the true position that no filter can beat on average, shape (T,), metres.

    Walls end where they end, heights are those of the building, sweeps see the walls that flash; all paths
    that exist are detected, and noise is as the measurements state it.

    Parameters
    ----------
    measurements : MeasurementSet
        What was measured in the building.
    truth : xarray.Dataset
        The truth of its dataset.
    order : int
        Largest number of bounces of a path, 1 or 2.
    """
    scenario = building_scenario(truth)
    return posterior_bounds(scenario, sensing_of(measurements, scenario, order)).position_mae_m


def building_scenario(truth: xr.Dataset) -> Scenario:
    """Walls, anchors and track of a truth, plan's frame."""
    anchors, track = truth["anchor_position_m"].values, truth["track_m"].values
    return Scenario(
        truth["wall_start_m"].values,
        truth["wall_end_m"].values,
        anchors[:, :2],
        track[:, :2],
        float(np.diff(truth["time_s"].values).mean()),
        (anchors[:, 2] - track[0, 2]) ** 2,
    )


def sensing_of(measurements: MeasurementSet, scenario: Scenario, order: int = 2) -> Sensing:
    """What was measured, by medians of the stated noise; the walls sensed are those that flash at the start.

    Parameters
    ----------
    measurements : MeasurementSet
        What was measured.
    scenario : Scenario
        The building.
    order : int
        Largest number of bounces of a path.
    """
    config = cast(GaussianConfig, config_for(measurements))  # the default engine's
    paths = [heard for epoch in measurements.epochs for heard in epoch.paths]
    spread = np.concatenate([[0.0], *(heard.range_std_m for heard in paths)])
    angles = np.concatenate([[], *(one.azimuth_std_rad for one in paths if one.azimuth_std_rad is not None)])
    swept = [epoch.index for epoch in measurements.epochs if epoch.sweep]
    flashes = [*measurements.walls, *(flash for epoch in measurements.epochs for flash in epoch.sweep)]
    law = [2.0 * np.trace(one.covariance_m2) / float(one.mean_m @ one.mean_m) for one in flashes]
    told = [epoch.odometry for epoch in measurements.epochs if epoch.odometry is not None]
    shares = [
        np.sqrt(one.covariance[0, 0]) / np.linalg.norm(one.displacement_m)
        for one in told
        if np.any(one.displacement_m)
    ]
    variance = float(np.median(law)) if law else Sensing.sweep_variance
    size2 = np.sum(scenario.vrps_m**2, axis=1)
    return Sensing(
        range_std_m=float(np.hypot(config.noise.range_std_m, np.median(spread))),
        order=order,
        sensed={
            wall: variance * 0.25 * size2[wall] for wall in np.flatnonzero(scenario.flashing()[0]).tolist()
        },
        sweep_every=swept[0] if swept else 0,
        sweep_variance=variance,
        flashes=True,
        lines_shared=True,
        odometry=(
            (float(np.median(shares)), float(np.median([np.sqrt(one.covariance[2, 2]) for one in told])))
            if shares
            else None
        ),
        azimuth_std_rad=float(np.median(angles)) if angles.size else None,
        height2_std_m2=config.noise.height2_std_m2,
        acceleration_variance=config.motion.acceleration_variance,
        velocity_std_m_s=config.motion.velocity_std_m_s,
    )
