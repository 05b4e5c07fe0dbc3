"""The map as a picture: walls, anchors and track with their uncertainties, and the errors.

A wall is drawn in full where its estimated reflection points lie, faintly beyond. Shaded
strips and ellipses are two standard deviations, enlarged (the legend says how much)
because they would otherwise hide under the lines.

Figures are made with Matplotlib's objects alone: no global state, no display. Equal
input gives equal files.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Polygon
from numpy.typing import ArrayLike, NDArray

from estimator.dataset import publish, require_absent, temporary_name
from estimator.errors import InputError
from estimator.evaluation.comparison import Truth, read_truth
from estimator.evaluation.metrics import best_rotation, derotated, distances
from estimator.evaluation.picture_style import (
    AGENT,
    AGENT_TRUE,
    ANCHOR,
    ANCHOR_TRUE,
    GRID,
    INK,
    MUTED,
    STYLE,
    TRUE,
    WALL,
)
from estimator.evaluation.wall_lines import line_points, line_std, seen_span
from estimator.geometry import rotation_matrix, wall_normal
from estimator.result import SlamResult

__all__ = ["draw_map", "require_picture_name", "save_figure"]

Array = NDArray[np.float64]

SUFFIXES = (".png", ".svg", ".pdf")

_SIGMAS = 2.0


def draw_map(result: SlamResult, truth: xr.Dataset | None = None, title: str | None = None) -> Figure:
    """Draw the map at the last epoch and the position error over time.

    Parameters
    ----------
    result : SlamResult
        Estimates of one run.
    truth : xarray.Dataset, optional
        Truth of its dataset. With it the picture is in the frame of the floor plan and
        shows true walls, anchors and track; without, it is in the estimator's frame.
    title : str, optional
        Head of the picture.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If the result has no epoch, or the truth belongs to another dataset.
    """
    if len(result.epoch) == 0:
        raise InputError("result: expected at least one epoch, got none")
    known = None if truth is None else read_truth(truth, result)
    with mpl.rc_context(STYLE):
        picture = _Map(result, known)
        width, height = np.ptp(picture.window, axis=1)
        tall = float(np.clip(7.4 * height / width, 2.5, 9.0))  # inches of the map, whose width is 7.4
        figure = Figure(figsize=(10.2, tall + 2.9), dpi=150, facecolor="white", layout="constrained")
        upper, lower = figure.subplots(2, 1, height_ratios=(tall, 1.6))
        picture.draw(upper)
        _draw_errors(lower, result, known)
        heading = title or f"{result.method} SLAM, {result.engine} engine"
        upper.set_title(heading, loc="left", fontsize=12.0, fontweight="bold", pad=10.0, parse_math=False)
        figure.draw_without_rendering()  # lays out while the style holds
    return figure


def require_picture_name(path: Path) -> None:
    """Check the name of a picture to write.

    Raises
    ------
    InputError
        If it does not end in ``.png``, ``.svg`` or ``.pdf``.
    OutputExistsError
        If ``path`` exists.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path}: expected a name that ends in {', '.join(SUFFIXES)}, got {path.suffix or 'no suffix'!r}"
        )
    require_absent(path)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically as PNG, SVG or PDF; raises as :func:`require_picture_name`."""
    path = Path(path)
    require_picture_name(path)
    suffix = path.suffix.lower()
    dated = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    temporary = temporary_name(path)
    try:
        with mpl.rc_context(STYLE):
            figure.savefig(temporary, format=suffix[1:], metadata=dated[suffix])
        publish(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


class _Map:
    """The map of a result at its last epoch, in the plan's frame if the truth is known."""

    def __init__(self, result: SlamResult, truth: Truth | None) -> None:
        self.result, self.truth = result, truth
        self.turn = rotation_matrix(0.0 if truth is None else truth.heading_rad)
        self.walls = [int(wall) for wall in np.flatnonzero(result.wall_valid[-1])]
        self.anchors = [int(anchor) for anchor in np.flatnonzero(result.anchor_valid[-1])]
        self.spans = {wall: seen_span(result, wall) for wall in self.walls}
        self.segments = {wall: self._points(wall, span) for wall, span in self.spans.items()}
        self.window = self._window()
        self.enlarged = self._enlargement()

    def draw(self, axes: Axes) -> None:
        """Draw everything, from the back to the front."""
        (left, right), (bottom, top) = self.window
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", axisbelow=True)
        axes.set(xlabel="x, m", ylabel="y, m")
        axes.grid(color=GRID, linewidth=0.8)
        axes.tick_params(length=0)
        self._draw_truth(axes)
        self._draw_walls(axes)
        self._draw_track(axes)
        self._draw_anchors(axes)
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, borderaxespad=0.0, labelspacing=0.8
        )

    def _place(self, points: Array) -> Array:
        return points if self.truth is None else self.truth.to_plan(points)

    def _points(self, wall: int, along_m: ArrayLike) -> Array:
        return self._place(line_points(self.result.wall_mean_m[-1, wall], along_m))

    def _draw_truth(self, axes: Axes) -> None:
        if self.truth is None:
            return
        segments = np.concatenate([surface.segments_m for surface in self.truth.surfaces])
        for row, segment in enumerate(self._place(segments)):
            label = "wall, true" if row == 0 else None
            axes.plot(*segment.T, color=TRUE, linewidth=7.0, solid_capstyle="round", label=label, zorder=1)
        axes.plot(
            *self._place(self.truth.track_m).T,
            color=AGENT_TRUE,
            linewidth=5.0,
            label="track, true",
            zorder=1,
        )
        anchors = self._place(self.truth.anchors_m)
        axes.plot(
            *anchors.T,
            linestyle="",
            marker="^",
            markersize=14.0,
            color=ANCHOR_TRUE,
            label="anchor, true",
            zorder=1,
        )

    def _draw_walls(self, axes: Axes) -> None:
        extent = 2.0 * float(np.ptp(self.window, axis=1).max())
        for row, (wall, segment) in enumerate(self.segments.items()):
            beyond = self._points(wall, (-extent, extent))
            axes.plot(*beyond.T, color=WALL, linewidth=0.8, alpha=0.45, linestyle=(0, (4, 4)), zorder=2)
            axes.add_patch(Polygon(self._strip(wall), facecolor=WALL, alpha=0.14, linewidth=0.0, zorder=2))
            label = "wall, estimated" if row == 0 else None
            axes.plot(*segment.T, color=WALL, linewidth=1.8, solid_capstyle="round", label=label, zorder=3)
        for wall, number, first in _births(self.result):
            text = f"wall {number}, from {first:g} s"
            x, y = self.segments[wall].mean(axis=0)
            axes.annotate(text, (x, y), (0, 6), textcoords="offset points", ha="center", color=WALL, zorder=5)

    def _strip(self, wall: int) -> Array:
        """Outline of a wall's line moved across by its standard deviations, shape (n, 2)."""
        vrp = self.result.wall_mean_m[-1, wall]
        along = np.linspace(*self.spans[wall], 33)
        std = line_std(vrp, self.result.wall_covariance_m2[-1, wall], along)
        offset = (_SIGMAS * self.enlarged * std)[:, None] * (self.turn @ wall_normal(vrp))
        middle = self._points(wall, along)
        return np.concatenate([middle + offset, (middle - offset)[::-1]])

    def _draw_track(self, axes: Axes) -> None:
        track = self._place(self.result.agent_mean[:, :2])
        axes.plot(*track.T, color=AGENT, linewidth=1.6, label="track, estimated", zorder=4)
        every = max(1, len(track) // 10)
        for epoch in range(len(track) - 1, 0, -every):
            self._ellipse(axes, track[epoch], self.result.agent_covariance[epoch, :2, :2], AGENT)
        axes.plot(*track[0], marker="o", markersize=7.0, color=AGENT, markerfacecolor="white", zorder=5)
        axes.annotate("start (RP)", track[0], (0, -14), textcoords="offset points", ha="center", color=AGENT)
        axes.plot(*track[-1], marker="o", markersize=6.0, color=AGENT, zorder=5)

    def _draw_anchors(self, axes: Axes) -> None:
        means = self._place(self.result.anchor_mean_m[-1])
        for row, anchor in enumerate(self.anchors):
            self._ellipse(axes, means[anchor], self.result.anchor_covariance_m2[-1, anchor], ANCHOR)
            label = "anchor, estimated" if row == 0 else None
            axes.plot(
                *means[anchor], marker="^", markersize=6.0, linestyle="", color=ANCHOR, label=label, zorder=5
            )
            axes.annotate(
                self.result.anchors[anchor],
                means[anchor],
                (0, 12),
                textcoords="offset points",
                ha="center",
                color=ANCHOR,
                parse_math=False,  # a name is text
            )
        label = f"{_SIGMAS:g} standard deviations" + (f", x {self.enlarged}" if self.enlarged > 1 else "")
        axes.add_patch(Ellipse((np.nan, np.nan), 1, 1, facecolor=MUTED, alpha=0.3, label=label))

    def _ellipse(self, axes: Axes, centre: Array, covariance: Array, colour: str) -> None:
        values, vectors = np.linalg.eigh(self.turn @ covariance @ self.turn.T)
        width, height = 2.0 * _SIGMAS * self.enlarged * np.sqrt(np.maximum(values, 0.0))
        angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        shape = {"facecolor": colour, "alpha": 0.22, "linewidth": 0.0, "zorder": 3}
        axes.add_patch(Ellipse((float(centre[0]), float(centre[1])), width, height, angle=angle, **shape))

    def _window(self) -> Array:
        """Limits of the picture, shape (2, 2): x and y, from and to."""
        shown = [self._place(self.result.agent_mean[:, :2])]
        shown.append(self._place(self.result.anchor_mean_m[-1, self.anchors]))
        if self.truth is None:
            shown.extend(self.segments.values())
        else:
            shown.extend(self._place(surface.segments_m).reshape(-1, 2) for surface in self.truth.surfaces)
        points = np.concatenate(shown)
        low, high = points.min(axis=0), points.max(axis=0)
        margin = max(0.05 * float((high - low).max()), 1.0)
        return np.stack([low - margin, high + margin], axis=1)

    def _enlargement(self) -> int:
        """Factor that makes a typical ellipse about a fiftieth of the picture wide."""
        sizes = [float(np.sqrt(np.trace(c))) for c in self.result.agent_covariance[1:, :2, :2]]
        wanted = 0.015 * float(np.ptp(self.window, axis=1).max())
        typical = max(float(np.median(sizes)) if sizes else wanted, 1e-9)
        return max(
            factor for factor in (1, 2, 5, 10, 20, 50, 100) if factor == 1 or factor * typical <= 2.0 * wanted
        )


def _draw_errors(axes: Axes, result: SlamResult, truth: Truth | None) -> None:
    """Position error and claimed standard deviation over time."""
    claimed = np.sqrt(np.trace(result.agent_covariance[:, :2, :2], axis1=1, axis2=2))
    axes.fill_between(
        result.time_s, claimed, color=AGENT, alpha=0.13, linewidth=0.0, label="claimed standard deviation"
    )
    highest = float(claimed.max())
    if truth is not None:
        track = result.agent_mean[:, :2]
        for error, colour, width, label in _errors(track, truth.track_m):
            axes.plot(result.time_s, error, color=colour, linewidth=width, label=label)
            highest = max(highest, float(error.max()))
    for _, number, first in _births(result):
        axes.axvline(first, color=WALL, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.annotate(
            f" wall {number}",
            (first, 1.0),
            xycoords=("data", "axes fraction"),
            va="top",
            color=WALL,
            fontsize=8.0,
        )
    axes.set(xlim=(result.time_s[0], result.time_s[-1] or 1.0), ylim=(0.0, 1.12 * highest or 1.0))
    axes.set(xlabel="time, s", ylabel="position error, m", axisbelow=True)
    axes.grid(color=GRID, linewidth=0.8)
    axes.tick_params(length=0)
    axes.legend(
        loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, borderaxespad=0.0, labelspacing=0.8
    )


def _errors(track: Array, truth: Array) -> Iterator[tuple[Array, str, float, str]]:
    """The lines of the error panel: values, colour, width, label."""
    turned = derotated(track, float(best_rotation(track, truth)))
    for error, colour, width, name in (
        (distances(track, truth), AGENT, 1.6, "error"),
        (distances(turned, truth), INK, 1.0, "rotation removed"),
    ):
        yield error, colour, width, f"{name} (mean {error.mean():.3f} m)"


def _births(result: SlamResult) -> Iterator[tuple[int, int, float]]:
    """Walls of the last epoch that were not there at the first: row, number, time of confirmation."""
    for wall in np.flatnonzero(result.wall_valid[-1] & ~result.wall_valid[0]):
        first = int(np.argmax(result.wall_valid[:, wall]))
        yield int(wall), int(result.wall_id[wall]), float(result.time_s[first])
