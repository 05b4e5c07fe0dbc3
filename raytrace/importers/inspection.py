"""What is in a drawing, before anything is imported: layers, levels, unit, extent, and a picture."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.errors import InputError
from raytrace.importers import geojson, ifc, imdf, osm
from raytrace.importers.convert import read_drawing
from raytrace.importers.drawing import Drawing
from raytrace.importers.options import ImportOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_drawing", "inspect_drawing"]

# Layers that a picture names; the rest is grey.
_MOST_NAMED = 10
MAPS = {".geojson": geojson.features_in, ".json": geojson.features_in, ".osm": osm.features_in}


def inspect_drawing(
    path: Path, options: ImportOptions | None = None, meshes: tuple[Path, ...] = ()
) -> tuple[dict[str, Any], Drawing]:
    """What a drawing holds, with everything that can be a line taken as one.

    Parameters
    ----------
    path : Path
        The file.
    options : ImportOptions, optional
        How it would be imported.
    meshes : tuple of Path
        Meshes that a Mitsuba scene may use.

    Returns
    -------
    dict
        ``file``, ``notes`` (the unit among them), ``levels``, ``extent_m`` (width and depth), ``layers``
        (by name, none of a map: ``lines``, ``length_m``, and what each would be ``taken_as``), ``kept`` and
        ``dropped`` (what an import would take for what), ``warnings``, and ``problem``: what an import
        would end with.
    Drawing
        All lines.

    Raises
    ------
    InputError
        If the file cannot be read at all.
    """
    options = ImportOptions() if options is None else options
    levels = _levels_in(path)
    chosen = options if options.level or len(levels) < 2 else replace(options, level=levels[0])
    problem, report = "", None
    if chosen is not options:
        problem = (
            f"levels: expected one level, got {len(levels)} ({', '.join(levels)}); choose one with --level"
        )
    try:
        report = read_drawing(path, chosen, meshes).report
    except InputError as error:
        problem = problem or str(error)
    unit = options.unit if report is None else _unit_of(report.notes)
    everything = replace(chosen, materials={"*": "concrete"}, material="concrete", unit=unit)
    try:
        drawing = read_drawing(path, everything, meshes)
    except InputError as error:
        if "unit" not in str(error) or unit is not None:
            raise
        drawing = read_drawing(path, replace(everything, unit="m"), meshes)
        drawing.report.notes.append("no unit known: extents are in units of the file")
    ends = np.array([(line.start_m, line.end_m) for line in drawing.lines]).reshape(-1, 2)
    layers: dict[str, dict[str, Any]] = defaultdict(lambda: {"lines": 0, "length_m": 0.0})
    for line in drawing.lines if not _is_map(path) else ():  # features have no layers
        layers[line.source]["lines"] += 1
        layers[line.source]["length_m"] += line.length_m
    for name, facts in layers.items():
        facts["length_m"] = round(facts["length_m"], 2)
        facts["taken_as"] = options.material_of(name) or "left out"
    return {
        "file": str(path),
        "notes": (report or drawing.report).notes,
        "levels": levels,
        "extent_m": [round(float(size), 3) for size in np.ptp(ends, axis=0)] if len(ends) else [0.0, 0.0],
        "layers": dict(sorted(layers.items())),
        "kept": {} if report is None else report.as_dict()["kept"],
        "dropped": {} if report is None else report.as_dict()["dropped"],
        "warnings": (report or drawing.report).warnings,
        "problem": problem,
    }, drawing


def _is_map(path: Path) -> bool:
    return path.suffix.lower() in MAPS or imdf.is_imdf(path)


def _levels_in(path: Path) -> list[str]:
    """Levels that a file states, in order."""
    suffix = path.suffix.lower()
    if imdf.is_imdf(path):
        return geojson.levels_in(imdf.venue_features(path))
    if suffix == ".ifc":
        return ifc.levels_in(path.read_bytes())
    return geojson.levels_in(MAPS[suffix](path.read_bytes())) if suffix in MAPS else []


def _unit_of(notes: list[str]) -> str | None:
    """The unit that an import would take, as its notes tell."""
    return next((note.split()[1].rstrip(",") for note in notes if note.startswith("unit ")), None)


def draw_drawing(drawing: Drawing, title: str) -> Figure:
    """All lines of a drawing, a colour for each of the layers with most of them."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    by_layer: dict[str, list[Any]] = defaultdict(list)
    for line in drawing.lines:
        by_layer[line.source].append((line.start_m, line.end_m))
    ordered = sorted(by_layer, key=lambda name: -len(by_layer[name]))
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    for number, name in enumerate(ordered):
        named = number < _MOST_NAMED
        colour = f"C{number}" if named else "0.7"
        label = f"{name} ({len(by_layer[name])})" if named else None
        axes.add_collection(LineCollection(by_layer[name], colors=colour, linewidths=0.8, label=label))
    axes.autoscale()
    axes.set_aspect("equal")
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.set_title(title, loc="left", parse_math=False)
    legend = axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    for text in legend.get_texts():
        text.set_parse_math(False)
    return figure
