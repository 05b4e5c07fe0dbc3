"""How pictures look: colours, fonts, axes."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

__all__ = [
    "AGENT",
    "AGENT_TRUE",
    "ANCHOR",
    "ANCHOR_TRUE",
    "DASHES",
    "GRID",
    "INK",
    "MUTED",
    "STYLE",
    "TRUE",
    "WALL",
    "colour_of",
    "logarithmic",
    "tidy",
]

INK, MUTED, GRID, TRUE = "#1d1d1b", "#6b6a66", "#e9e8e4", "#bdbbb4"
AGENT, ANCHOR, WALL = "#2466c4", "#c8501e", "#1f8a66"
AGENT_TRUE, ANCHOR_TRUE = "#bcd0f2", "#f2c9b5"
DASHES = (0, (4, 3))
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.edgecolor": TRUE,
    "axes.labelcolor": MUTED,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "hapslam",
}
"""Matplotlib parameters of all pictures."""

_LINES = (AGENT, ANCHOR, WALL, "#8a4bb0", "#b08a1f", "#3aa6b9", "#b03a5b")


def colour_of(number: int) -> str:
    """Colour of the line with this number; they repeat after seven."""
    return _LINES[number % len(_LINES)]


def tidy(axes: Axes) -> None:
    """A grid behind what is drawn, and no tick marks."""
    axes.set(axisbelow=True)
    axes.grid(color=GRID, linewidth=0.8)
    axes.tick_params(which="both", length=0)


def logarithmic(axes: Axes) -> None:
    """A logarithmic vertical axis with plain numbers at 1, 2 and 5 of each decade."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
