"""What the agent's odometry measures of its true track, with noise."""

from __future__ import annotations

import numpy as np
import xarray as xr

from estimator.geometry import rotate
from estimator.odometry import Odometry, odometry_variables
from raytrace.plan.floorplan import FloorPlan

__all__ = ["with_odometry"]


def with_odometry(shard: xr.Dataset, plan: FloorPlan, rng: np.random.Generator) -> xr.Dataset:
    """A shard of passive channels with the odometry of its epochs, if the plan's agent has some.

    The body's x axis at the start is the estimator's; it turns as the direction of travel does. Each
    component of a displacement has an error of ``displacement_std_share`` of its length, the turn one of
    ``turn_std_rad``; the covariance that is written is that of the measured length.

    Parameters
    ----------
    shard : Dataset
        With the coordinate ``epoch``.
    plan : FloorPlan
        The plan.
    rng : numpy.random.Generator
        The same for all shards: the noise of a step does not depend on where a track is cut.
    """
    noise = plan.agent.odometry
    if noise is None:
        return shard
    track, body = plan.track()[:, :2], plan.body_azimuths_rad()
    ways, turns = np.diff(track, axis=0), np.angle(np.exp(1j * np.diff(body)))
    draws = rng.standard_normal((plan.agent.epochs - 1, 3))
    found: list[Odometry | None] = [None]
    for way, azimuth, turn, drawn in zip(ways, body[:-1], turns, draws, strict=True):
        seen = rotate(way, -azimuth) + noise.displacement_std_share * np.linalg.norm(way) * drawn[:2]
        std = noise.displacement_std_share * np.linalg.norm(seen)
        spread = np.diag([std**2, std**2, noise.turn_std_rad**2])
        found.append(Odometry(seen, turn + noise.turn_std_rad * drawn[2], spread))
    return shard.assign(odometry_variables([found[epoch] for epoch in shard["epoch"].values]))
