"""What an experiment leaves: a picture, the numbers as JSON, and a text beside the paper's statements."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from estimator.dataset import require_absent, write_text
from estimator.evaluation.pictures import save_figure

__all__ = ["SUFFIXES", "Report", "Row", "figure_text", "require_places", "write_report"]

SUFFIXES = (".png", ".svg", ".json", ".txt")


@dataclass(frozen=True)
class Row:
    """A line of the comparison.

    Parameters
    ----------
    quantity : str
        What is compared, with its unit.
    ours, paper, limit : str
        As text; empty where there is nothing to say.
    """

    quantity: str
    ours: str
    paper: str = ""
    limit: str = ""


@dataclass(frozen=True, eq=False)
class Report:
    """A finished experiment.

    Parameters
    ----------
    name, title : str
        Name of the figure and what it shows.
    summary : mapping
        The numbers that matter, JSON types.
    data : mapping
        What is drawn, JSON types.
    rows : sequence of Row
        The comparison with the paper and the limit.
    picture : Figure
        The drawing.
    notes : sequence of str
        Choices where the paper is silent, departures from it.
    settings : mapping
        Runs, seed and the like.
    """

    name: str
    title: str
    summary: Mapping[str, Any]
    data: Mapping[str, Any]
    rows: Sequence[Row]
    picture: Figure
    notes: Sequence[str] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)


def figure_text(value: float | None, error: float | None = None, digits: int = 3) -> str:
    """A number with its standard error: ``0.381 +- 0.021``; a dash for None."""
    if value is None:
        return "-"
    text = f"{value:.{digits}f}"
    return text if error is None else f"{text} +- {error:.{digits}f}"


def require_places(folder: Path, names: Iterable[str]) -> None:
    """Raise OutputExistsError if a file of one of these experiments exists already."""
    for name in names:
        for suffix in SUFFIXES:
            require_absent(folder / f"{name}{suffix}")


def write_report(report: Report, folder: Path) -> None:
    """Write picture (PNG and SVG), numbers (JSON) and text to a folder, which is made if need be.

    Raises
    ------
    OutputExistsError
        If one of the files exists; nothing is written then.
    """
    require_places(folder, [report.name])
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {
        "figure": report.name,
        "title": report.title,
        "settings": dict(report.settings),
        "summary": dict(report.summary),
        "data": dict(report.data),
    }
    write_text(json.dumps(numbers, indent=1, allow_nan=False) + "\n", folder / f"{report.name}.json")
    write_text(as_text(report), folder / f"{report.name}.txt")
    for suffix in (".png", ".svg"):
        save_figure(report.picture, folder / f"{report.name}{suffix}")


def as_text(report: Report) -> str:
    """The comparison as aligned columns, then settings and notes."""
    head = Row("", "here", "paper", "limit")
    cells = [(row.quantity, row.ours, row.paper, row.limit) for row in (head, *report.rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(4)]
    lines = [f"{report.name}: {report.title}", ""]
    lines += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
    lines += ["", *(f"{key}: {value}" for key, value in report.settings.items())]
    lines += [f"- {note}" for note in report.notes]
    return "\n".join(line.rstrip() for line in lines) + "\n"
