"""True and predicted coverage side by side, and their difference, drawn in the frame of the true plan."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.geometry import rotate
from raytrace.pictures.plans import COLOURS, style
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.space import confined
from raytrace.prediction.channels import predict, predict_grid

__all__ = ["draw_comparison"]

Array = NDArray[np.float64]
_SPAN_DB = 40.0  # of the colours of powers
_DIFFERENCE_DB = 6.0  # and of differences, either way


def draw_comparison(
    true: FloorPlan, twin: FloorPlan, start_m: Array, heading_rad: float, mapped_m: Array, step_m: float = 0.5
) -> Figure:
    """Draw where the strongest anchor's power is predicted, and where it is.

    Parameters
    ----------
    true, twin : FloorPlan
        The true plan and the estimated one; anchors of the twin have the names of the true ones.
    start_m, heading_rad : ndarray, shape (2,) or (3,), and float
        Where the mapped track began in the true plan, and the direction of the estimator's x axis there.
    mapped_m : ndarray, shape (M, 2)
        The mapped track, estimator's frame.
    step_m : float
        Distance between points, metres.
    """
    origin = np.asarray(start_m)[:2]
    known = {anchor.name for anchor in twin.anchors}
    kept = tuple(anchor for anchor in true.anchors if anchor.name in known)
    x, y, exact = predict_grid(true.model_copy(update={"anchors": kept}), step_m)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    guess = predict(twin, rotate(points - origin, -heading_rad))
    inside = _inside(true, points)
    powers = [_decibels(channels.power.max(axis=1), inside) for channels in (exact, guess)]
    top = float(np.nanpercentile(powers[0], 99.0)) if np.isfinite(powers[0]).any() else 0.0
    panels = [
        ("true", powers[0], "viridis", top - _SPAN_DB, top, true.walls_m()),
        ("predicted", powers[1], "viridis", top - _SPAN_DB, top, _placed(twin, origin, heading_rad)),
        ("difference", powers[1] - powers[0], "RdBu_r", -_DIFFERENCE_DB, _DIFFERENCE_DB, true.walls_m()),
    ]
    with style():
        height = 3.2 * np.ptp(y) / max(np.ptp(x), step_m) + 0.9
        figure = Figure(figsize=(12.0, height), layout="constrained")
        for axes, (title, values, colours, low, high, walls) in zip(
            figure.subplots(1, 3, sharex=True, sharey=True), panels, strict=True
        ):
            image = axes.pcolormesh(
                x,
                y,
                values.reshape(len(y), len(x)),
                cmap=mpl.colormaps[colours],
                vmin=low,
                vmax=high,
                shading="nearest",
                rasterized=True,
            )
            _draw_walls(axes, *walls)
            track = rotate(mapped_m, heading_rad) + origin
            axes.plot(*track.T, color=COLOURS["ink"], linewidth=0.6, linestyle=":")
            axes.set(title=title, aspect="equal", xlabel="x, m")
            figure.colorbar(image, ax=axes, label="dB" if title == "difference" else "gain, dB", shrink=0.7)
    return figure


def _decibels(power: Array, inside: NDArray[np.bool_]) -> Array:
    shown = inside & (power > 0.0)
    return np.where(shown, 10.0 * np.log10(np.where(shown, power, 1.0)), np.nan)


def _inside(plan: FloorPlan, points: Array) -> NDArray[np.bool_]:
    """Points that the walls confine."""
    return np.asarray(shapely.contains_xy(confined(*plan.walls_m()), points[:, 0], points[:, 1]))


def _placed(plan: FloorPlan, origin: Array, heading_rad: float) -> tuple[Array, Array]:
    """Ends of an estimated plan's walls in the true plan."""
    start, end = plan.walls_m()
    return rotate(start, heading_rad) + origin, rotate(end, heading_rad) + origin


def _draw_walls(axes: Axes, start: Array, end: Array) -> None:
    lines = LineCollection(list(np.stack([start, end], axis=1)), colors=COLOURS["ink"], linewidths=1.2)
    axes.add_collection(lines)
