"""How a drawing is to be read: units, materials of layers, heights, what counts as one wall."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Literal

from estimator.errors import ConfigurationError
from raytrace.plan.materials import ITU_MATERIALS
from raytrace.plan.space import KINDS, SpaceKind

__all__ = ["IGNORE", "UNITS_M", "ImportOptions", "words_of"]

IGNORE = "ignore"

UNITS_M = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "in": 0.0254,
    "ft": 0.3048,
    "yd": 0.9144,
    "km": 1000.0,
}

# Words in the names of layers, features and objects, and what they are made of. What no wave
# meets comes first (a "wall-door" is a door), then the materials by their own names.
_NOTHING = frozenset(
    ("door", "tuer", "tür", "text", "txt", "dim", "dimension", "hatch", "furn", "furniture")
    + ("opening", "defpoints", "anno", "annotation", "grid", "axis")
)
_WORDS = {
    "glass": frozenset(("glaz", "glazing", "window", "wind", "fenster", "curtain")),
    "brick": frozenset(("masonry", "mason", "ziegel", "mauerwerk", "kalksandstein")),
    "plasterboard": frozenset(
        ("plaster", "gypsum", "gyps", "drywall", "partition", "prtn", "gips", "gipskarton", "trockenbau")
    ),
    "metal": frozenset(("steel", "rack", "shelf", "shelving", "aluminium", "aluminum", "stahl")),
    "wood": frozenset(("timber", "holz", "oak", "pine")),
    "concrete": frozenset(("conc", "beton", "stahlbeton", "wall", "wand", "column", "cols", "pillar")),
}


@dataclass(frozen=True)
class ImportOptions:
    """How a drawing is to be read.

    Parameters
    ----------
    materials : mapping of str to str
        Material of every layer, feature or object whose name fits a pattern (``*`` and
        ``?``, upper and lower case alike); ``ignore`` leaves it out. The first pattern
        that fits counts, and counts before the words that names are searched for.
    material : str or None
        Material of what no pattern and no word fits; ``None`` leaves it out.
    unit : str or None
        Unit of the coordinates, a key of :data:`UNITS_M`, where the file tells none or is
        to be overruled.
    height_m : float
        Height of walls that the file does not tell, metres.
    thickness_m : float
        Thickness of single lines, metres.
    thickest_m : float
        Two parallel lines nearer than this are the two faces of one wall, metres.
    cut_m : float
        Height above the lowest point at which solid models are cut, metres.
    up : {"z", "y"} or None
        Which axis of a solid model points upwards; ``None`` takes the format's: y of glTF, else z.
    level : str or None
        Level (storey) to take of a file that has several.
    hatches : bool
        Take the outlines of hatches on layers of walls as walls.
    walk_m : tuple of tuple
        Way-points of the agent in the coordinates of the plan, metres; none places them.
    anchors_m : tuple of tuple
        Anchors (x, y, z), metres; those of the file and of chance are then not asked.
    space : {"inside", "outside"} or None
        Where the agent is to walk; ``None`` takes the plan's main space.

    Raises
    ------
    ConfigurationError
        If a value is out of its range or a material is unknown.
    """

    materials: Mapping[str, str] = field(default_factory=dict)
    material: str | None = None
    unit: str | None = None
    height_m: float = 3.0
    thickness_m: float = 0.2
    thickest_m: float = 0.5
    cut_m: float = 1.2
    up: Literal["z", "y"] | None = None
    level: str | None = None
    hatches: bool = False
    walk_m: tuple[tuple[float, float], ...] = ()
    anchors_m: tuple[tuple[float, float, float], ...] = ()
    space: SpaceKind | None = None

    def __post_init__(self) -> None:
        for name in ("height_m", "thickness_m", "thickest_m", "cut_m"):
            value = getattr(self, name)
            if not 0.0 < value < 1000.0:
                raise ConfigurationError(f"{name}: expected metres above 0 and below 1000, got {value!r}")
        if self.unit is not None and self.unit not in UNITS_M:
            raise ConfigurationError(f"unit: expected one of {', '.join(UNITS_M)}, got {self.unit!r}")
        if self.space not in (None, *KINDS):
            raise ConfigurationError(f"space: expected {' or '.join(KINDS)}, got {self.space!r}")
        if len(self.walk_m) == 1:
            raise ConfigurationError("walk: expected at least two way-points, got one")
        if self.up not in ("z", "y", None):
            raise ConfigurationError(f"up: expected 'z' or 'y', got {self.up!r}")
        known = {*ITU_MATERIALS, IGNORE}
        for pattern, material in [*self.materials.items(), ("material", self.material or IGNORE)]:
            if material not in known:
                raise ConfigurationError(
                    f"{pattern}: expected one of {', '.join(ITU_MATERIALS)} or {IGNORE!r}, got {material!r}"
                )

    def told_of(self, name: str) -> str | None:
        """Material that the user gave to what is named so, or ``"ignore"``; ``None`` if none was given."""
        lower = name.lower()
        return next((m for pattern, m in self.materials.items() if fnmatchcase(lower, pattern.lower())), None)

    def material_of(self, name: str) -> str | None:
        """Material of what is named so, ``"ignore"``, or ``None`` if nothing tells."""
        told = self.told_of(name)
        if told is not None:
            return told
        lower = name.lower()
        words = words_of(name)
        if words & _NOTHING:
            return IGNORE
        spelled = f"_{'_'.join(re.findall('[a-z]+', lower))}_"
        named = [m for m in ITU_MATERIALS if f"_{m}_" in spelled]
        if named:
            return max(named, key=len)
        return next((material for material, known in _WORDS.items() if words & known), self.material)


def words_of(name: str) -> frozenset[str]:
    """Words of a name, in small letters and singular: ``A-WALLS`` and ``innerWall`` both have a wall."""
    words = [word.lower() for word in re.findall(r"[A-ZÄÖÜ]?[a-zäöüß]+|[A-ZÄÖÜ]+", name)]
    return frozenset([*words, *(word.removesuffix("s") for word in words)])
