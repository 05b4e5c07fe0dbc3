"""Drawings of a room and of what a run made of it, in the plan's frame."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from numpy.typing import ArrayLike, NDArray

from estimator.evaluation.picture_style import AGENT, AGENT_TRUE, ANCHOR, ANCHOR_TRUE, TRUE, WALL, tidy
from estimator.evaluation.wall_lines import line_points, seen_span
from estimator.experiments.room import Room
from estimator.result import SlamResult

__all__ = ["draw_ellipse", "draw_result", "draw_room"]

Array = NDArray[np.float64]

_SIGMAS = 2.0


def draw_room(axes: Axes, room: Room, margin_m: float = 6.0) -> None:
    """Draw the true walls, track and anchors, and frame them."""
    plan = room.scenario
    for start, end in zip(plan.start_m, plan.end_m, strict=True):
        axes.plot(
            *np.stack([start, end], axis=1), color=TRUE, linewidth=5.0, solid_capstyle="round", zorder=1
        )
    axes.plot(*plan.track_m.T, color=AGENT_TRUE, linewidth=4.0, zorder=1)
    axes.plot(*plan.anchors_m.T, linestyle="", marker="^", markersize=11.0, color=ANCHOR_TRUE, zorder=2)
    corners = np.concatenate([plan.start_m, plan.end_m, plan.anchors_m, plan.track_m])
    low, high = corners.min(axis=0) - margin_m, corners.max(axis=0) + margin_m
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x, m", ylabel="y, m")
    tidy(axes)


def draw_result(axes: Axes, room: Room, result: SlamResult) -> None:
    """Draw the estimated track, and walls and anchors as they are at the last epoch."""
    origin = room.scenario.track_m[0]
    for wall in np.flatnonzero(result.wall_valid[-1]).tolist():
        ends = line_points(result.wall_mean_m[-1, wall], seen_span(result, wall)) + origin
        axes.plot(*ends.T, color=WALL, linewidth=1.6, solid_capstyle="round", zorder=3)
    axes.plot(*(result.agent_mean[:, :2] + origin).T, color=AGENT, linewidth=1.3, zorder=4)
    for anchor in np.flatnonzero(result.anchor_valid[-1]).tolist():
        place = result.anchor_mean_m[-1, anchor] + origin
        draw_ellipse(axes, place, result.anchor_covariance_m2[-1, anchor], ANCHOR)
        axes.plot(*place, marker="^", markersize=5.0, linestyle="", color=ANCHOR, zorder=5)


def draw_ellipse(axes: Axes, centre: ArrayLike, covariance: Array, colour: str, label: str = "") -> None:
    """Draw two standard deviations of a point."""
    x, y = np.asarray(centre, dtype=np.float64)
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2.0 * _SIGMAS * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    shape = Ellipse((float(x), float(y)), width, height, angle=angle, facecolor=colour, edgecolor=colour)
    shape.set(alpha=0.3, zorder=3, label=label or None)
    axes.add_patch(shape)
