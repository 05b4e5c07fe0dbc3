"""What a feature of a map is: wall, opening, anchor, track, or nothing that a wave meets.

Properties count whatever their case. A feature says what it is by ``role`` (ours), by the keys of
OpenStreetMap (Simple Indoor Tagging: ``indoor``, ``door``, ``entrance``; ``building`` and ``barrier``;
ways and things with ``highway``, ``amenity`` and the like are no walls), by ``feature_type`` (IMDF:
units and fixtures are walls, openings open them), or by a material, class, category, type, layer or
name, which is searched for words as layers of drawings are. What none of this tells is concrete.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from estimator.errors import FileFormatError
from raytrace.importers.options import IGNORE, ImportOptions, words_of
from raytrace.plan.materials import ITU_MATERIALS

__all__ = ["Meaning", "levels_of", "lowered", "meaning", "metres_of"]

_ROLES = ("wall", "anchor", "track", "walkable", "opening", IGNORE)
_NAMES = ("material", "class", "category", "feature_type", "featuretype", "type", "layer", "name")
_LEVELS = ("level", "levels", "level_id", "storey", "story", "floor", "ordinal")
# OpenStreetMap's indoor=*, and what it stands for; "area" and "corridor" have no walls of their own.
_INDOOR = {
    "room": "wall", "wall": "wall", "column": "wall", "window": "wall", "yes": "wall",
    "door": "opening", "entrance": "opening",
    "area": IGNORE, "corridor": IGNORE, "level": IGNORE, "pathway": IGNORE, "stairs": IGNORE,
    "elevator": IGNORE,
}  # fmt: skip
_OPEN_KEYS = ("door", "entrance")
_NO_WALLS = (
    "highway",
    "railway",
    "waterway",
    "aeroway",
    "landuse",
    "leisure",
    "natural",
    "amenity",
    "power",
) + ("footway", "public_transport", "furniture", "vending", "emergency", "information", "tourism", "route")
# IMDF's feature types (those of drawings of others are not in this table).
_IMDF = {
    "unit": "wall", "fixture": "wall", "kiosk": "wall", "opening": "opening",
    "level": IGNORE, "footprint": IGNORE, "building": IGNORE, "venue": IGNORE, "address": IGNORE,
    "amenity": IGNORE, "anchor": IGNORE, "occupant": IGNORE, "section": IGNORE, "geofence": IGNORE,
    "relationship": IGNORE, "detail": IGNORE, "facility": IGNORE,
}  # fmt: skip
# Words of things that are drawn on maps and hold back no wave.
_THINGS = frozenset(
    ("wheelchair", "icon", "symbol", "poi", "label", "road", "street", "path", "footpath", "tree", "toilet")
    + ("stair", "elevator", "lift", "escalator", "ramp", "parking", "marker", "arrow", "walkway", "sign")
)
_DOORS = frozenset(("door", "tuer", "tür", "entrance", "opening"))
_NUMBER = re.compile(
    r"\s*(\d+(?:[.,]\d+)?|[.,]\d+)\s*(m|metres?|meters?|cm|mm|ft|\'|in|\")?\s*$", re.IGNORECASE
)
_FACTORS = {"cm": 0.01, "mm": 0.001, "ft": 0.3048, "'": 0.3048, "in": 0.0254, '"': 0.0254}


@dataclass(frozen=True)
class Meaning:
    """What a feature is: its role, its material if it is a wall, and the property that told, for reports."""

    role: str
    material: str = ""
    label: str = ""


def lowered(properties: Mapping[str, Any]) -> dict[str, Any]:
    """Properties by their names in small letters; of two that differ by case alone the first counts."""
    found: dict[str, Any] = {}
    for key, value in properties.items():
        found.setdefault(str(key).lower(), value)
    return found


def meaning(where: str, properties: Mapping[str, Any], kind: str, options: ImportOptions) -> Meaning:
    """What a feature is.

    Parameters
    ----------
    where : str
        Its place in the file, for messages.
    properties : mapping
        What is said of it.
    kind : str
        Type of its geometry.
    options : ImportOptions
        Materials of names, and of what nothing else tells.

    Raises
    ------
    FileFormatError
        If its role or material is unknown.
    """
    said = lowered(properties)
    if "role" in said:
        role = said["role"]
        if role not in _ROLES:
            raise FileFormatError(
                f"{where}.properties.role: expected one of {', '.join(_ROLES)}, got {role!r}"
            )
        return Meaning(role, _material(where, said, options) if role == "wall" else "")
    named = [str(said[key]) for key in _NAMES if isinstance(said.get(key), str)]
    if kind == "Point" and "anchor" in " ".join(named).lower() and "feature_type" not in said:
        return Meaning("anchor")
    for name in named:  # what the user says of a layer counts before all conventions
        by_user = options.told_of(name)
        if by_user is not None:
            return Meaning(IGNORE if by_user == IGNORE else "wall", by_user)
    found = _of_keys(said) or _of_words(named)
    if found is not None and found.role != "wall":
        return found
    material = _material(where, said, options)
    label = found.label if found is not None else repr(named[0]) if named else ""
    return Meaning(IGNORE if material == IGNORE else "wall", material, label)


def _of_keys(said: Mapping[str, Any]) -> Meaning | None:
    """What the keys of OpenStreetMap and IMDF tell."""
    indoor = said.get("indoor")
    if isinstance(indoor, str) and indoor.lower() in _INDOOR:
        return Meaning(_INDOOR[indoor.lower()], label=f"indoor={indoor}")
    for key in _OPEN_KEYS:
        if said.get(key) not in (None, "no"):
            return Meaning("opening", label=f"{key}={said[key]}")
    kind = said.get("feature_type", said.get("featuretype"))
    if isinstance(kind, str) and kind.lower() in _IMDF:
        return Meaning(_IMDF[kind.lower()], label=f"feature_type={kind}")
    for key in ("building", "barrier"):
        if said.get(key) not in (None, "no"):
            return Meaning("wall", label=f"{key}={said[key]}")
    thing = next((key for key in _NO_WALLS if said.get(key) not in (None, "no")), None)
    return None if thing is None else Meaning(IGNORE, label=f"{thing}={said[thing]}")


def _of_words(named: list[str]) -> Meaning | None:
    """What words in names tell of things that are no walls."""
    for name in named:
        words = words_of(name)
        if words & _DOORS:
            return Meaning("opening", label=repr(name))
        if words & _THINGS:
            return Meaning(IGNORE, label=repr(name))
    return None


def _material(where: str, said: Mapping[str, Any], options: ImportOptions) -> str:
    stated = said.get("material")
    if stated is not None and not isinstance(stated, str):
        raise FileFormatError(f"{where}.properties.material: expected a name, got {stated!r}")
    for key in _NAMES:
        if isinstance(said.get(key), str):
            found = options.material_of(said[key])
            if found is not None:
                return found
    if stated is not None:
        raise FileFormatError(
            f"{where}.properties.material: expected one of {', '.join(ITU_MATERIALS)}, got {stated!r}"
        )
    return "glass" if said.get("indoor") == "window" else "concrete"


def metres_of(where: str, properties: Mapping[str, Any], name: str, default: float) -> float:
    """A length that a feature states as ``NAME_m`` or ``NAME``: a number, or a text like ``"3.5 m"``.

    Raises
    ------
    FileFormatError
        If it is no length above 0 and below a kilometre.
    """
    said = lowered(properties)
    for key in (f"{name}_m", name):
        value = said.get(key)
        if value is None or value == "":
            continue
        number = value
        if isinstance(value, str) and (match := _NUMBER.match(value)) is not None:
            unit = (match[2] or "m").lower()
            number = float(match[1].replace(",", ".")) * _FACTORS.get(unit, 1.0)
        if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 < number < 1000.0:
            raise FileFormatError(f"{where}.properties.{key}: expected metres above 0, got {value!r}")
        return float(number)
    return default


def levels_of(
    where: str, properties: Mapping[str, Any], names: Mapping[str, Mapping[str, Any]]
) -> frozenset[str]:
    """Levels that a feature is on, as texts: ``level=1``, ``"0;1"``, ``"0-2"``; empty if it states none.

    Parameters
    ----------
    where : str
        Its place in the file, for messages.
    properties : mapping
        What is said of it.
    names : mapping
        Properties of the features that are levels themselves (IMDF), by their ``id``.

    Raises
    ------
    FileFormatError
        If a range of levels is absurd.
    """
    said = lowered(properties)
    if said.get("feature_type") == "level":
        return frozenset([_number(said["ordinal"])]) if "ordinal" in said else frozenset()
    value = next((said[key] for key in _LEVELS if said.get(key) not in (None, "")), None)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return frozenset()
    known = names.get(str(value))
    if known is not None and "ordinal" in lowered(known):
        return frozenset([_number(lowered(known)["ordinal"])])
    found: set[str] = set()
    for piece in str(value).split(";"):
        between = re.fullmatch(r"\s*(-?\d+)\s*-\s*(-?\d+)\s*", piece)
        if between is None:
            found.add(_number(piece.strip()))
            continue
        low, high = sorted((int(between[1]), int(between[2])))
        if high - low > 200:
            raise FileFormatError(f"{where}: expected at most 200 levels, got {piece!r}")
        found |= {str(level) for level in range(low, high + 1)}
    return frozenset(found - {""})


def _number(value: Any) -> str:
    """A level's name: whole numbers without their decimals."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return str(value)
    return str(int(number)) if number.is_integer() else str(value)
