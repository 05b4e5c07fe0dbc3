"""Pictures of a floor plan: the plan itself, paths drawn in it, and what power reaches where.

Paths and power come from the image method, so that no ray tracer is needed. Figures are
made with Matplotlib's objects alone: no global state, no display.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from estimator.errors import InputError
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.coverage import lattice, path_gains
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import PathList
from raytrace.propagation.reflectors import mirrored, surfaces_of

__all__ = ["COLOURS", "draw_coverage", "draw_paths", "draw_plan", "path_vertices", "received_power", "style"]

Array = NDArray[np.float64]

COLOURS = {"ink": "#1d1d1b", "muted": "#6b6a66", "grid": "#e9e8e4", "agent": "#2466c4", "anchor": "#c8501e"}
_MATERIALS = {
    "concrete": "#5d5b56",
    "brick": "#a8503a",
    "plasterboard": "#b49a6a",
    "glass": "#3fa7c4",
    "metal": "#3b4a78",
    "wood": "#8a6a3a",
}
_OTHER_MATERIAL = "#7a5c99"
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.edgecolor": "#bdbbb4",
    "axes.labelcolor": COLOURS["muted"],
    "axes.titlecolor": COLOURS["ink"],
    "text.color": COLOURS["ink"],
    "xtick.color": COLOURS["muted"],
    "ytick.color": COLOURS["muted"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "hapslam",
}
# Power from free space to nothing that a receiver hears, dB between the ends of the colours.
_SPAN_DB = 60.0


@contextmanager
def style() -> Iterator[None]:
    """The look of all pictures, while a figure is made."""
    with mpl.rc_context(_STYLE):
        yield


def draw_plan(plan: FloorPlan) -> Figure:
    """Draw walls by material, anchors, targets, and the agents' tracks.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with style():
        figure, axes = _canvas(plan, plan.name)
        _draw_walls(axes, plan)
        _draw_stations(axes, plan)
        _finish(figure, axes)
    return figure


def draw_paths(plan: FloorPlan, epoch: int, depth: int | None = None) -> Figure:
    """Draw all specular paths to the agent at one epoch, strong ones dark.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    epoch : int
        Where the agent is.
    depth : int, optional
        Most bounces; by default the plan's.

    Raises
    ------
    InputError
        If the plan has no such epoch.
    """
    if not 0 <= epoch < plan.agent.epochs:
        raise InputError(f"epoch: expected 0 to {plan.agent.epochs - 1}, got {epoch}")
    place = plan.track()[epoch : epoch + 1]
    paths = image_paths(plan, place, depth).flat()
    vertices = path_vertices(plan, paths, place)
    with style():
        heading = f"{len(paths)} paths at epoch {epoch}"
        figure, axes = _canvas(plan, f"{plan.name}: {heading}")
        _draw_walls(axes, plan)
        power_db = 20.0 * np.log10(np.maximum(np.abs(paths.amplitude), 1e-15))
        order = np.argsort(power_db)
        lines = [vertices[row, : paths.order[row] + 2, :2] for row in order]
        collection = LineCollection(lines, cmap="viridis_r", linewidths=1.0, zorder=3)
        collection.set_array(power_db[order])
        if len(paths):
            collection.set_norm(Normalize(float(power_db.max()) - _SPAN_DB, float(power_db.max())))
        axes.add_collection(collection)
        _draw_stations(axes, plan, track=False)
        axes.plot(*place[0, :2], marker="o", markersize=7.0, color=COLOURS["agent"], zorder=5, label="agent")
        figure.colorbar(collection, ax=axes, label="path gain, dB", shrink=0.7)
        _finish(figure, axes)
    return figure


def draw_coverage(
    plan: FloorPlan,
    depth: int = 1,
    anchor: int | None = None,
    step_m: float | None = None,
    over_sent: bool = False,
) -> Figure:
    """Draw the power that the agent would receive everywhere, at its height.

    Parameters
    ----------
    plan : FloorPlan
        The plan.
    depth : int
        Most bounces of the paths whose powers are added.
    anchor : int, optional
        One anchor; by default the strongest at each place.
    step_m : float, optional
        From place to place, metres; by default as fine as a picture needs.
    over_sent : bool
        Whether powers are over what the anchor sends: where nobody knows that.

    Raises
    ------
    InputError
        If the plan has no such anchor.
    """
    x, y, power = received_power(plan, depth, step_m)
    what, unit = ("gain", "dB") if over_sent else ("received power", "dBm")
    power = power - plan.radio.eirp_dbm if over_sent else power
    if anchor is not None and not 0 <= anchor < len(plan.anchors):
        raise InputError(f"anchor: expected 0 to {len(plan.anchors) - 1}, got {anchor}")
    shown = power.max(axis=-1) if anchor is None else power[..., anchor]
    with style():
        of = "strongest anchor" if anchor is None else plan.anchors[anchor].name
        most = "1 bounce" if depth == 1 else f"{depth} bounces"
        figure, axes = _canvas(plan, f"{plan.name}: {what}, {of}, up to {most}")
        heard = shown[np.isfinite(shown)]
        top = float(np.percentile(heard, 99.5)) if heard.size else 0.0
        image = axes.pcolormesh(
            x, y, shown.T, cmap="viridis", vmin=top - _SPAN_DB, vmax=top, shading="nearest", rasterized=True
        )
        figure.colorbar(image, ax=axes, label=f"{what}, {unit}", shrink=0.7)
        _draw_walls(axes, plan, colour=COLOURS["ink"])
        _draw_stations(axes, plan)
        _finish(figure, axes)
    return figure


def received_power(
    plan: FloorPlan, depth: int = 1, step_m: float | None = None
) -> tuple[Array, Array, Array]:
    """Power from each anchor on a lattice over the plan, phases averaged out.

    Parameters
    ----------
    plan : FloorPlan
        The plan; its ``radio.eirp_dbm`` is sent.
    depth : int
        Most bounces.
    step_m : float, optional
        From place to place, metres; by default as fine as a picture needs.

    Returns
    -------
    x, y : ndarray, shapes (columns,), (rows,)
        Places of the lattice, metres.
    power_dbm : ndarray, shape (columns, rows, anchors)
        dBm; NaN outside of the walls (in scenes where the agent walks inside), ``-inf`` where
        no path arrives.
    """
    x, y = lattice(plan, step_m)
    with np.errstate(divide="ignore"):
        return x, y, plan.radio.eirp_dbm + 10.0 * np.log10(path_gains(plan, x, y, depth))


def path_vertices(plan: FloorPlan, paths: PathList, positions_m: Array) -> Array:
    """Where paths start, bounce and end.

    Parameters
    ----------
    plan : FloorPlan
        The plan that the paths belong to.
    paths : PathList
        Specular paths.
    positions_m : ndarray, shape (epochs, 3)
        Positions of the agent that ``paths.epoch`` counts, metres.

    Returns
    -------
    ndarray, shape (paths, bounces + 2, 3)
        Anchor, bounces, agent; NaN beyond.
    """
    surfaces, anchors = surfaces_of(plan), plan.anchors_m()
    vertices = np.full((len(paths), paths.walls.shape[1] + 2, 3), np.nan)
    for row in range(len(paths)):
        walls = paths.walls[row, : paths.order[row]]
        images = [anchors[paths.anchor[row]]]
        for wall in walls:
            images.append(mirrored(surfaces, images[-1][None], np.array([wall]))[0])
        vertices[row, 0] = images[0]
        point = vertices[row, len(walls) + 1] = positions_m[paths.epoch[row]]
        for bounce in range(len(walls), 0, -1):
            normal, origin = surfaces.normal[walls[bounce - 1]], surfaces.origin[walls[bounce - 1]]
            towards = images[bounce] - point
            point = point + towards * (((origin - point) @ normal) / (towards @ normal))
            vertices[row, bounce] = point
    return vertices


def _canvas(plan: FloorPlan, title: str) -> tuple[Figure, Axes]:
    start, end = plan.walls_m()
    points = np.vstack([start, end])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.03 * float((high - low).max()), 0.3)
    width, height = high - low + 2.0 * margin
    figure = Figure(
        figsize=(9.5, float(np.clip(7.0 * height / width, 2.5, 9.0)) + 0.8),
        dpi=150,
        facecolor="white",
        layout="constrained",
    )
    axes = figure.subplots()
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(aspect="equal", xlabel="x, m", ylabel="y, m", axisbelow=True)
    axes.grid(color=COLOURS["grid"], linewidth=0.8)
    axes.tick_params(length=0)
    axes.set_title(title, loc="left", fontsize=12.0, fontweight="bold", pad=10.0, parse_math=False)
    return figure, axes


def _draw_walls(axes: Axes, plan: FloorPlan, colour: str | None = None) -> None:
    start, end = plan.walls_m()
    segments = np.stack([start, end], axis=1)
    for material in dict.fromkeys(wall.material for wall in plan.walls):
        mine = [wall.material == material for wall in plan.walls]
        drawn = colour or _MATERIALS.get(material, _OTHER_MATERIAL)
        label = None if colour else material
        axes.add_collection(
            LineCollection(list(segments[mine]), colors=drawn, linewidths=2.4, label=label, zorder=2)
        )


def _draw_stations(axes: Axes, plan: FloorPlan, track: bool = True) -> None:
    """Anchors, targets and, if wanted, the agents' tracks."""
    if track:
        points = plan.track()[:, :2]
        axes.plot(*points.T, color=COLOURS["agent"], linewidth=1.4, label="track", zorder=4)
        axes.plot(*points[0], marker="o", color=COLOURS["agent"], markerfacecolor="white", zorder=5)
        for name, alone in list(plan.by_agent().items())[1:]:
            points = alone.track()[:, :2]
            axes.plot(*points.T, linewidth=1.4, linestyle="--", label=f"track of {name}", zorder=4)
            axes.plot(*points[0], marker="o", color=COLOURS["agent"], markerfacecolor="white", zorder=5)
    if plan.targets:
        for target in plan.targets:
            axes.plot(*target.motion(plan.times_s()).place_m[:, :2].T, ":", color=COLOURS["muted"], zorder=4)
        x, y = np.array([target.motion(np.zeros(1)).place_m[0, :2] for target in plan.targets]).T
        axes.plot(x, y, "s", color=COLOURS["muted"], markersize=5.0, label="target", zorder=5)
    for row, anchor in enumerate(plan.anchors):
        x, y, _ = anchor.position_m
        label = "anchor" if row == 0 else None
        axes.plot(
            x, y, marker="^", markersize=8.0, linestyle="", color=COLOURS["anchor"], label=label, zorder=6
        )
        axes.annotate(
            anchor.name,
            (x, y),
            (0, 8),
            textcoords="offset points",
            ha="center",
            color=COLOURS["anchor"],
            zorder=6,
            parse_math=False,  # a name is text
            path_effects=[withStroke(linewidth=3.0, foreground="white", alpha=0.8)],
        )


def _finish(figure: Figure, axes: Axes) -> None:
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=8, frameon=False)
    figure.draw_without_rendering()  # lays out while the style holds
