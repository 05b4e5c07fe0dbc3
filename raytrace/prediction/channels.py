"""Channels that a floor plan predicts at any positions: paths, powers, delay spreads, lines of sight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.waveform import OfdmGrid
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import PathSet
from raytrace.radio.channel import channel_response

__all__ = ["Channels", "channels_of", "predict", "predict_grid"]

Array = NDArray[np.float64]
_MOST_POINTS = 200_000  # of a grid: some minutes


@dataclass(frozen=True, eq=False)
class Channels:
    """Channels of T positions and K anchors.

    Parameters
    ----------
    paths : PathSet
        The paths, axes (T, K, path).
    power : ndarray, shape (T, K)
        Sum of the powers of all paths, over the EIRP; 0 where there is none.
    wideband_power : ndarray, shape (T, K)
        Mean power over the tones of the link: paths that are not resolved interfere.
    delay_spread_s : ndarray, shape (T, K)
        Root-mean-square delay spread, seconds; NaN where there is no path.
    line_of_sight : ndarray of bool, shape (T, K)
        Whether the direct path is there.
    """

    paths: PathSet
    power: Array
    wideband_power: Array
    delay_spread_s: Array
    line_of_sight: NDArray[np.bool_]


def channels_of(paths: PathSet, grid: OfdmGrid) -> Channels:
    """The channels that paths are.

    Parameters
    ----------
    paths : PathSet
        Paths of T positions and K anchors.
    grid : OfdmGrid
        The link's tones.
    """
    power = np.where(paths.valid, np.abs(paths.amplitude) ** 2, 0.0)
    total = power.sum(axis=-1)
    delay = np.where(paths.valid, paths.delay_s, 0.0)
    share = power / np.where(total > 0.0, total, 1.0)[..., None]
    mean = np.sum(share * delay, axis=-1)
    spread = np.sqrt(np.maximum(np.sum(share * (delay - mean[..., None]) ** 2, axis=-1), 0.0))
    response = channel_response(paths, grid)[:, :, 0]
    return Channels(
        paths,
        total,
        np.mean(np.abs(response) ** 2, axis=-1),
        np.where(total > 0.0, spread, np.nan),
        np.asarray((paths.valid & (paths.order == 0)).any(axis=-1)),
    )


def predict(plan: FloorPlan, positions_m: ArrayLike, depth: int | None = None) -> Channels:
    """The channels of a plan's anchors at some positions, by the image method.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    positions_m : array_like, shape (T, 2) or (T, 3)
        Positions in the plan, metres; at the agent's height unless they tell theirs.
    depth : int, optional
        Most bounces; by default the plan's.

    Raises
    ------
    InputError
        If the positions are none, not finite, or of another shape.
    """
    places = np.asarray(positions_m, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] not in (2, 3) or not len(places):
        raise InputError(f"positions_m: expected shape (T, 2) or (T, 3), got {places.shape}")
    if not np.isfinite(places).all():
        raise InputError("positions_m: expected finite numbers")
    if places.shape[1] == 2:
        places = np.column_stack([places, np.full(len(places), plan.agent.height_m)])
    paths = image_paths(plan, places, plan.tracing.depth if depth is None else depth)
    gain = 10.0 ** (plan.gain_offsets_db() / 20.0)
    return channels_of(replace(paths, amplitude=paths.amplitude * gain[:, None]), plan.radio.grid())


def predict_grid(
    plan: FloorPlan, step_m: float = 0.5, depth: int | None = None
) -> tuple[Array, Array, Channels]:
    """The channels on a grid over the plan: coverage.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    step_m : float
        Distance between points, metres.
    depth : int, optional
        Most bounces.

    Returns
    -------
    x_m, y_m : ndarray, shapes (X,) and (Y,)
        Coordinates of the grid.
    channels : Channels
        Of its points, x running fastest: T = X Y.
    """
    start, end = plan.walls_m()
    low, high = np.minimum(start, end).min(axis=0), np.maximum(start, end).max(axis=0)
    if not 0.0 < step_m < np.inf:
        raise InputError(f"step_m: expected a positive number, got {step_m}")
    x, y = (np.arange(a + 0.5 * step_m, b, step_m) for a, b in zip(low, high, strict=True))
    if x.size * y.size > _MOST_POINTS:
        raise InputError(f"step_m: expected at most {_MOST_POINTS} points, got {x.size * y.size}")
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return x, y, predict(plan, points, depth)
