"""IMDF: a venue as a folder of GeoJSON files, or the archive of one (Indoor Mapping Data Format, 1.0).

Units, fixtures and kiosks have walls, openings open them, levels give the others their ordinals; venues,
footprints, occupants, amenities and the like are not drawn. Units that are open to one another
(walkways, lobbies, what has no walls of its own) share none: of these only the outline of all together is
a wall. Of an archive nothing is unpacked to disk.
"""

from __future__ import annotations

import io
import zipfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import shapely
from shapely.geometry import shape

from estimator.errors import FileFormatError
from raytrace.importers.drawing import LARGEST_BYTES, Drawing
from raytrace.importers.geojson import Feature, drawing_of, features_in
from raytrace.importers.options import ImportOptions

__all__ = ["is_imdf", "read_imdf", "venue_features"]

# Files of the features that are drawn, or that tell levels.
_DRAWN = ("level", "unit", "fixture", "kiosk", "opening")
# Categories of units from which one walks to the next, or falls, without passing a wall.
_OPEN = frozenset(
    ("walkway", "walkway.island", "lobby", "unenclosedarea", "opentobelow", "escalator", "movingwalkway")
    + ("ramp", "stairs", "steps", "platform", "terrace", "parking", "road", "footbridge", "fieldofplay")
    + ("vegetation", "waitingroom", "foodcourt", "recreation", "smokingarea")
)


def is_imdf(path: Path) -> bool:
    """Whether a path is a folder or a .zip file, which are read as venues."""
    return path.is_dir() or path.suffix.lower() == ".zip"


def read_imdf(path: Path, options: ImportOptions) -> Drawing:
    """Read one level of a venue.

    Parameters
    ----------
    path : Path
        Folder with ``unit.geojson`` and others, or a .zip file of one.
    options : ImportOptions
        How to read it; ``level`` is an ordinal, 0 on the ground.

    Raises
    ------
    FileFormatError
        If there are no units, a file is damaged or too large, or there are several levels and none was
        chosen.
    """
    return drawing_of(venue_features(path), options)


def venue_features(path: Path) -> list[Feature]:
    """Features that are drawn, or tell levels; raises as :func:`read_imdf`."""
    features: list[Feature] = []
    named: set[str] = set()
    for kind, data in _files_of_folder(path) if path.is_dir() else _files_of_archive(path):
        named.add(kind)
        try:
            found = features_in(data)
        except FileFormatError as error:
            raise FileFormatError(f"{kind}.geojson: {error}") from error
        features += [
            (f"{kind}.geojson {where}", {"feature_type": kind, **properties}, geometry)
            for where, properties, geometry in found
        ]
    if "unit" not in named:
        raise FileFormatError(
            f"expected a venue (IMDF) with unit.geojson, got {', '.join(sorted(named)) or 'no file of one'}"
        )
    return list(_with_outlines(features))


def _files_of_folder(path: Path) -> Iterator[tuple[str, bytes]]:
    total = 0
    for kind in _DRAWN:
        file = path / f"{kind}.geojson"
        try:
            total += file.stat().st_size if file.exists() else 0
            _require_room(total)
            data = file.read_bytes() if file.exists() else b""
        except OSError as error:
            raise FileFormatError(f"{file}: expected a file, could not read it: {error.strerror}") from error
        if data:
            yield kind, data


def _files_of_archive(path: Path) -> Iterator[tuple[str, bytes]]:
    try:
        packed = path.read_bytes() if path.stat().st_size <= LARGEST_BYTES else b""
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            places = {Path(entry.filename).name: entry for entry in archive.infolist()}
            chosen = [(kind, places[name]) for kind in _DRAWN if (name := f"{kind}.geojson") in places]
            _require_room(sum(entry.file_size for _, entry in chosen))
            for kind, entry in chosen:
                with archive.open(entry) as stream:  # a header may lie about the size
                    data = stream.read(LARGEST_BYTES + 1)
                _require_room(len(data))
                if data:
                    yield kind, data
    except (OSError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise FileFormatError(f"expected an archive (.zip) of a venue, could not read it: {error}") from error


def _require_room(size: int) -> None:
    if size > LARGEST_BYTES:
        raise FileFormatError(f"expected at most {LARGEST_BYTES >> 20} MiB, got {size / 2**20:.0f} MiB")


def _with_outlines(features: Iterable[Feature]) -> Iterator[Feature]:
    """Features with the open units of each level as one."""
    open_units: dict[str, list[Any]] = defaultdict(list)
    levels: dict[str, Any] = {}
    for where, properties, geometry in features:
        category = str(properties.get("category", "")).lower()
        if properties["feature_type"] != "unit" or category not in _OPEN:
            yield where, properties, geometry
            continue
        level = properties.get("level_id")
        levels[str(level)] = level
        open_units[str(level)].append((where, geometry))
    for name, units in open_units.items():
        try:
            areas = shapely.make_valid(shapely.union_all([shape(geometry) for _, geometry in units]))
        except Exception as error:  # shapely raises errors of many kinds on wrong coordinates
            text = f"{type(error).__name__}: {error}"[:100]
            raise FileFormatError(f"{units[0][0]}.geometry: expected polygons: {text}") from error
        outline = {"feature_type": "unit", "category": "open units", "level_id": levels[name]}
        parts = [part for part in shapely.get_parts(areas) if part.geom_type == "Polygon"]
        yield from ((f"{units[0][0]} and others", outline, part.__geo_interface__) for part in parts)
