"""Where a person could walk among walls: the rooms behind their doors, or the open air between buildings.

Walls with gaps up to a door's width hold a room together: the area that they *confine* is what
is left of the plane when all is cut off that lies behind such gaps, seen from outside (the
morphological closing of the walls by half a door, holes filled). Free space is that area, or
the outside, less a clearance around the walls; its connected parts are the spaces of a plan.
Doors between rooms are gaps of the walls and join their spaces; closets, shafts and the
cavities of double walls are spaces of their own, and small.

The main space of a building is its largest part inside. Where several buildings stand apart, it is the
street between them; where nothing is confined (a wall in the open), the surroundings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from estimator.errors import ConfigurationError, InputError

__all__ = ["KINDS", "Space", "SpaceConfig", "SpaceKind", "confined", "enclosed", "main_space", "spaces"]

Array = NDArray[np.float64]
SpaceKind = Literal["inside", "outside"]
KINDS: tuple[SpaceKind, ...] = ("inside", "outside")

# Corners that meet within a millimetre are closed: drawings are made in millimetres.
_SNAP_M = 1e-3


@dataclass(frozen=True)
class SpaceConfig:
    """What counts as a door, a person and a street.

    Parameters
    ----------
    door_m : float
        Widest gap that counts as a door, metres: two leaves of one metre.
    clearance_m : float
        Distance that an agent keeps from a wall, metres: a little less than half of a narrow door.
    margin_m : float
        Distance that it keeps from the face of a thick wall at least, metres.
    sliver : float
        Buildings below this share of the largest one's area are sheds, and make no street.
    street : float
        Smallest share of the plan (its convex hull) that lies between buildings to be a street.
    surroundings_m : float
        How far beyond the walls of an open scene an agent walks, metres.
    """

    door_m: float = 2.0
    clearance_m: float = 0.3
    margin_m: float = 0.15
    sliver: float = 0.2
    street: float = 0.1
    surroundings_m: float = 5.0

    def __post_init__(self) -> None:
        for name in ("door_m", "clearance_m", "surroundings_m"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name}: expected metres above 0, got {getattr(self, name)!r}")


@dataclass(frozen=True, eq=False)
class Space:
    """A connected part of the free space.

    Parameters
    ----------
    kind : {"inside", "outside"}
        Whether walls confine it.
    free : shapely.Polygon
        Where an agent may stand, clearances taken off, metres.
    area_m2 : float
        The same up to the walls, square metres.
    share : float
        This area over all that is inside, or all that is between the buildings.
    """

    kind: SpaceKind
    free: shapely.Geometry
    area_m2: float
    share: float


def enclosed(start_m: Array, end_m: Array) -> shapely.Geometry:
    """The area that walls (n, 2), (n, 2) enclose without a gap; those up to a millimetre are closed."""
    network = shapely.union_all(shapely.set_precision(_lines(start_m, end_m), _SNAP_M))
    return shapely.union_all(shapely.get_parts(shapely.polygonize([*shapely.get_parts(network)])))


def confined(start_m: Array, end_m: Array, config: SpaceConfig | None = None) -> shapely.Geometry:
    """The area that walls (n, 2), (n, 2) confine when gaps up to a door's width are bridged."""
    config = SpaceConfig() if config is None else config
    exact = enclosed(start_m, end_m)
    reach = 0.5 * config.door_m
    thick = shapely.union_all(shapely.buffer(_lines(start_m, end_m), reach, quad_segs=16))
    outlines = shapely.polygons(shapely.get_exterior_ring(shapely.get_parts(thick)))
    closed = shapely.buffer(shapely.union_all(outlines), -reach * (1.0 + 1e-6), join_style="mitre")
    gained = shapely.area(closed) - shapely.area(exact)
    # Where nothing was bridged, the polygons of the walls themselves are exact.
    return exact if gained <= 1e-3 * shapely.area(exact) else shapely.union(exact, closed)


def spaces(
    start_m: Array, end_m: Array, thickness_m: Array, config: SpaceConfig | None = None
) -> list[Space]:
    """All connected free spaces of a plan, the largest first.

    Parameters
    ----------
    start_m, end_m : ndarray, shape (n, 2)
        Ends of the walls, metres.
    thickness_m : ndarray, shape (n,)
        Their thickness, metres.
    config : SpaceConfig, optional
        What counts as a door, a person and a street.
    """
    config = SpaceConfig() if config is None else config
    inside = confined(start_m, end_m, config)
    kept_off = _kept_off(start_m, end_m, thickness_m, config)
    outside = _outside(start_m, end_m, inside, kept_off, config)
    found = []
    regions: tuple[tuple[SpaceKind, shapely.Geometry], ...] = (("inside", inside), ("outside", outside))
    for kind, region in regions:
        for part in _polygons(shapely.difference(region, kept_off)):
            whole = shapely.intersection(shapely.buffer(part, config.clearance_m), region)
            share = shapely.area(whole) / shapely.area(region)
            found.append(Space(kind, part, float(shapely.area(whole)), float(share)))
    return sorted(found, key=lambda space: -space.area_m2)


def main_space(
    start_m: Array,
    end_m: Array,
    thickness_m: Array,
    kind: SpaceKind | None = None,
    config: SpaceConfig | None = None,
) -> Space:
    """The space in which an agent walks if nobody says where; arguments as of :func:`spaces`.

    Parameters
    ----------
    kind : {"inside", "outside"}, optional
        Where the user wants it; by default inside, or on the street if there is one.

    Raises
    ------
    InputError
        If no part is wide enough to walk in.
    """
    config = SpaceConfig() if config is None else config
    found = spaces(start_m, end_m, thickness_m, config)
    largest = {name: next((space for space in found if space.kind == name), None) for name in KINDS}
    inside, outside = largest["inside"], largest["outside"]
    if kind is None:
        buildings = _buildings(confined(start_m, end_m, config), config)
        hull = shapely.area(_hull(start_m, end_m))
        street = len(buildings) > 1 and outside is not None and outside.area_m2 >= config.street * hull
        # Between the walls of an open scene, or of one that is next to nothing inside, one walks outside.
        narrow = inside is None or (inside.share < 0.01 and outside is not None)
        chosen = outside if street or not buildings or narrow else inside
    else:
        chosen = largest[kind]
    if chosen is None:
        where = f" {kind}" if kind else ""
        raise InputError(
            f"walls: expected space{where} to walk {config.clearance_m:g} m from the walls, "
            f"got none among walls that span {_span(start_m, end_m)}"
        )
    return chosen


def _outside(
    start_m: Array, end_m: Array, inside: shapely.Geometry, kept_off: shapely.Geometry, config: SpaceConfig
) -> shapely.Geometry:
    """What lies between the walls (in their convex hull) but not inside; where that is narrow, around."""
    hull = _hull(start_m, end_m)
    between = shapely.difference(hull, inside)
    if shapely.area(shapely.difference(between, kept_off)) >= config.street * shapely.area(hull) > 0.0:
        return between
    return shapely.difference(shapely.buffer(hull, config.surroundings_m), inside)


def _hull(start_m: Array, end_m: Array) -> shapely.Geometry:
    return shapely.convex_hull(shapely.multipoints(np.vstack([start_m, end_m])))


def _lines(start_m: Array, end_m: Array) -> NDArray[np.object_]:
    return np.asarray(shapely.linestrings(np.stack([start_m, end_m], axis=1)), dtype=np.object_)


def _buildings(inside: shapely.Geometry, config: SpaceConfig) -> list[shapely.Geometry]:
    """Parts of the confined area that are not small beside the largest."""
    parts = _polygons(inside)
    largest = max((shapely.area(part) for part in parts), default=0.0)
    return [part for part in parts if shapely.area(part) >= config.sliver * largest]


def _kept_off(start_m: Array, end_m: Array, thickness_m: Array, config: SpaceConfig) -> shapely.Geometry:
    """What lies too near to a wall: the clearance, at the faces of thick walls more."""
    lines = _lines(start_m, end_m)
    beside = np.maximum(config.clearance_m, 0.5 * thickness_m + config.margin_m)
    thick = beside > config.clearance_m
    return shapely.union_all(
        [
            *shapely.buffer(lines, config.clearance_m, quad_segs=4),
            *shapely.buffer(lines[thick], beside[thick], cap_style="flat"),
        ]
    )


def _polygons(geometry: shapely.Geometry) -> list[shapely.Geometry]:
    parts = shapely.get_parts(geometry)
    return [part for part in parts if part.geom_type == "Polygon" and not part.is_empty]


def _span(start_m: Array, end_m: Array) -> str:
    width, depth = np.ptp(np.vstack([start_m, end_m]), axis=0)
    return f"{width:.3g} m by {depth:.3g} m"
