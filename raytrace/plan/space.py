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
# Areas are computed on a grid, on which no intersection is missed for lack of digits.
_GRID_M = 1e-4


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
    partitions : float
        Buildings whose inner walls are longer than this share of their outlines are drawn with their
        rooms: storeys on one sheet, or a campus, where one walks inside.
    surroundings_m : float
        How far beyond the walls of an open scene an agent walks, metres.
    """

    door_m: float = 2.0
    clearance_m: float = 0.3
    margin_m: float = 0.15
    sliver: float = 0.2
    street: float = 0.1
    partitions: float = 0.5
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
    network = shapely.union_all(_lines(start_m, end_m), grid_size=_SNAP_M)
    rooms = shapely.get_parts(shapely.polygonize([*shapely.get_parts(network)]))
    return _areas(shapely.union_all(rooms, grid_size=_GRID_M))


def confined(start_m: Array, end_m: Array, config: SpaceConfig | None = None) -> shapely.Geometry:
    """The area that walls (n, 2), (n, 2) confine when gaps up to a door's width are bridged."""
    config = SpaceConfig() if config is None else config
    exact = enclosed(start_m, end_m)
    reach = 0.5 * config.door_m
    thick = shapely.union_all(shapely.buffer(_lines(start_m, end_m), reach, quad_segs=8))
    outlines = shapely.polygons(shapely.get_exterior_ring(shapely.get_parts(thick)))
    filled = shapely.union_all(outlines, grid_size=_GRID_M)
    closed = _areas(shapely.buffer(filled, -reach * (1.0 + 1e-6), join_style="mitre"))
    gained = shapely.area(closed) - shapely.area(exact)
    # Where nothing was bridged, the polygons of the walls themselves are exact.
    return (
        exact
        if gained <= 1e-3 * shapely.area(exact)
        else _areas(shapely.union(exact, closed, grid_size=_GRID_M))
    )


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
    return _spaces(start_m, end_m, thickness_m, confined(start_m, end_m, config), config)


def _spaces(
    start_m: Array, end_m: Array, thickness_m: Array, inside: shapely.Geometry, config: SpaceConfig
) -> list[Space]:
    kept_off = _kept_off(start_m, end_m, thickness_m, config)
    outside = _outside(start_m, end_m, inside, kept_off, config)
    found = []
    regions: tuple[tuple[SpaceKind, shapely.Geometry], ...] = (("inside", inside), ("outside", outside))
    for kind, region in regions:
        for part in _polygons(shapely.difference(region, kept_off, grid_size=_GRID_M)):
            grown = shapely.buffer(part, config.clearance_m, quad_segs=4)
            whole = shapely.intersection(grown, region, grid_size=_GRID_M)
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
    confines = confined(start_m, end_m, config)
    found = _spaces(start_m, end_m, thickness_m, confines, config)
    largest = {name: next((space for space in found if space.kind == name), None) for name in KINDS}
    inside, outside = largest["inside"], largest["outside"]
    if kind is None:
        buildings = _buildings(confines, config)
        hull = shapely.area(_hull(start_m, end_m))
        street = (
            len(buildings) > 1
            and outside is not None
            and outside.area_m2 >= config.street * hull
            and not (inside is not None and _have_rooms(buildings, start_m, end_m, config))
        )
        chosen = outside if street or not buildings else inside
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
    between = _areas(shapely.difference(hull, inside, grid_size=_GRID_M))
    if (
        shapely.area(shapely.difference(between, kept_off, grid_size=_GRID_M))
        >= config.street * shapely.area(hull)
        > 0.0
    ):
        return between
    around = shapely.buffer(hull, config.surroundings_m)
    return _areas(shapely.difference(around, inside, grid_size=_GRID_M))


def _hull(start_m: Array, end_m: Array) -> shapely.Geometry:
    return shapely.convex_hull(shapely.multipoints(np.vstack([start_m, end_m])))


def _lines(start_m: Array, end_m: Array) -> NDArray[np.object_]:
    return np.asarray(shapely.linestrings(np.stack([start_m, end_m], axis=1)), dtype=np.object_)


def _buildings(inside: shapely.Geometry, config: SpaceConfig) -> list[shapely.Geometry]:
    """Parts of the confined area that are not small beside the largest."""
    parts = _polygons(inside)
    largest = max((shapely.area(part) for part in parts), default=0.0)
    return [part for part in parts if shapely.area(part) >= config.sliver * largest]


def _have_rooms(buildings: list[shapely.Geometry], start_m: Array, end_m: Array, config: SpaceConfig) -> bool:
    """Whether buildings are drawn with their inner walls, not as mere outlines."""
    core = shapely.union_all(shapely.buffer(buildings, -0.5 * config.door_m), grid_size=_GRID_M)
    shapely.prepare(core)
    middles = 0.5 * (start_m + end_m)
    within = shapely.contains_xy(core, middles[:, 0], middles[:, 1])
    inner = float(np.linalg.norm(end_m - start_m, axis=1)[within].sum())
    outline = float(np.sum(shapely.length(shapely.get_exterior_ring(buildings))))
    return inner > config.partitions * outline


def _kept_off(start_m: Array, end_m: Array, thickness_m: Array, config: SpaceConfig) -> shapely.Geometry:
    """What lies too near to a wall: the clearance, at the faces of thick walls more."""
    lines = _lines(start_m, end_m)
    beside = np.maximum(config.clearance_m, 0.5 * thickness_m + config.margin_m)
    thick = beside > config.clearance_m
    return shapely.union_all(
        [
            *shapely.buffer(lines, config.clearance_m, quad_segs=4),
            *shapely.buffer(lines[thick], beside[thick], cap_style="flat"),
        ],
        grid_size=_GRID_M,
    )


def _areas(geometry: shapely.Geometry) -> shapely.Geometry:
    """A geometry without the points and lines that an overlay leaves where areas touch."""
    parts = _polygons(geometry)
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def _polygons(geometry: shapely.Geometry) -> list[shapely.Geometry]:
    parts = shapely.get_parts(geometry)
    return [part for part in parts if part.geom_type == "Polygon" and not part.is_empty]


def _span(start_m: Array, end_m: Array) -> str:
    width, depth = np.ptp(np.vstack([start_m, end_m]), axis=0)
    return f"{width:.3g} m by {depth:.3g} m"
