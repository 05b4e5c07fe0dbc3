"""Materials from unresolved paths: what walls are made of where reflections arrive together.

In narrow places paths differ by less than the bandwidth resolves, and interfere with phases that a map does
not know. Their powers then add up on average only: of a cluster of paths with powers ``p_i``, the
measured power has the mean ``sum p_i`` and, relative to it, the variance ``1 - sum p_i^2 / (sum p_i)^2``.
Slabs are chosen wall by wall so that all clusters of a run are likeliest (Gamma laws of these moments).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError
from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.materials import slab_reflection
from raytrace.propagation.directions import directions_of
from raytrace.propagation.images import image_paths
from raytrace.propagation.paths import PathList
from raytrace.propagation.reflectors import surfaces_of
from raytrace.propagation.slab_fit import WALL_MATERIALS

__all__ = ["ClusterFit", "Clusters", "clusters_of", "refine_materials"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Slabs = dict[str, tuple[str, float, dict[str, float]]]
_COSINES = 65  # of the table of coefficients, evenly spaced


@dataclass(frozen=True)
class ClusterFit:
    """How slabs are fitted to clusters.

    Parameters
    ----------
    materials : tuple of str
        Candidates.
    thickness_m : tuple of float
        Their thicknesses: unresolved paths do not tell more finely.
    resolution_m : float
        Paths whose lengths differ by less are one cluster.
    floors : tuple of float
        Relative standard deviations of a measured power that is not fading: large ones first, so that no wall
        sticks at a slab that suits the others' wrong ones.
    most : float
        What one cluster costs at most in the end, nats: some hold paths that the map does not know.
    rounds : int
        Times that every wall is visited with each of them.
    tempering : float
        Share of the log likelihood that probabilities are told from: neighbours along a track fade alike.
    starts : tuple of str
        All walls start as they are, and as each of these; the likeliest end counts.
    """

    materials: tuple[str, ...] = WALL_MATERIALS
    thickness_m: tuple[float, ...] = (0.006, 0.01, 0.013, 0.02, 0.03, 0.05, 0.08, 0.1, 0.12, 0.16, 0.24)
    resolution_m: float = 0.75
    floors: tuple[float, ...] = (1.0, 0.4, 0.1)
    most: float = 8.0
    rounds: int = 4
    tempering: float = 0.02
    starts: tuple[str, ...] = ("concrete", "plasterboard")

    def __post_init__(self) -> None:
        if not self.materials or not self.thickness_m or not self.floors or self.rounds < 1:
            raise ConfigurationError("materials, thickness_m, floors, rounds: expected at least one of each")


@dataclass(frozen=True, eq=False)
class Clusters:
    """Paths of a plan that arrive together, and what was measured of each cluster.

    Parameters
    ----------
    paths : PathList
        The paths.
    cluster : ndarray of int64, shape (N,)
        Cluster of each path.
    measured : ndarray, shape (C,)
        Power that was measured of each cluster, over the EIRP; 0 where none was.
    """

    paths: PathList
    cluster: Index
    measured: Array


def clusters_of(
    plan: FloorPlan,
    positions_m: Array,
    lengths_m: Sequence[Sequence[Array]],
    gains_db: Sequence[Sequence[Array]],
    resolution_m: float = 0.75,
) -> Clusters:
    """Group the paths of a plan along a track by what the link resolves.

    Parameters
    ----------
    plan : FloorPlan
        The plan; its anchors in the order of the measurements.
    positions_m : ndarray, shape (T, 3)
        The track.
    lengths_m, gains_db : sequence of sequence of ndarray
        Measured lengths and gains by epoch and anchor.
    resolution_m : float
        Lengths that differ by less are not resolved.
    """
    paths = image_paths(plan, positions_m).flat()
    order = np.lexsort([paths.delay_s, paths.anchor, paths.epoch])
    paths = paths.select(order)
    length = paths.delay_s * SPEED_OF_LIGHT_M_S
    same = (np.diff(paths.epoch) == 0) & (np.diff(paths.anchor) == 0) & (np.diff(length) < resolution_m)
    cluster = np.concatenate([[0], np.cumsum(~same)]) if len(paths) else np.zeros(0, dtype=np.int64)
    count = int(cluster.max(initial=-1)) + 1
    measured = np.zeros(count)
    first = np.searchsorted(cluster, np.arange(count))
    last = np.searchsorted(cluster, np.arange(count), side="right") - 1
    reach = 0.5 * resolution_m
    for c in range(count):
        t, k = int(paths.epoch[first[c]]), int(paths.anchor[first[c]])
        found = lengths_m[t][k]
        mine = (found > length[first[c]] - reach) & (found < length[last[c]] + reach)
        measured[c] = np.sum(10.0 ** (gains_db[t][k][mine] / 10.0))
    return Clusters(paths, cluster, measured)


def refine_materials(
    plan: FloorPlan, clusters: Clusters, free: Sequence[str], config: ClusterFit | None = None
) -> Slabs:
    """The likeliest slabs of some walls.

    Parameters
    ----------
    plan : FloorPlan
        The plan, with the slabs to begin with.
    clusters : Clusters
        Its paths, and what was measured.
    free : sequence of str
        Walls whose slab is not known; walls that share a prefix before ``-part-`` are told apart.
    config : ClusterFit, optional
        How.

    Returns
    -------
    dict
        By the wall's name: material, thickness in metres, and probabilities of the materials given the other
        walls. Walls that no measured cluster involves are left out.
    """
    config = config or ClusterFit()
    search = _Search(plan, clusters, config)
    free = [name for name in free if search.touches(name)]
    if not free:
        return {}
    found = [search.descend(free, material) for material in (None, *config.starts)]
    return min(found, key=lambda pair: pair[0])[1]


class _Search:
    """The clusters of a plan with tables of every candidate, for descents from several starts."""

    def __init__(self, plan: FloorPlan, clusters: Clusters, config: ClusterFit) -> None:
        known = clusters.measured > 0.0
        among = np.flatnonzero(known[clusters.cluster])
        paths = clusters.paths.select(among)
        self._config, self._walls = config, paths.walls
        self._cluster = np.searchsorted(np.flatnonzero(known), clusters.cluster[among])
        self._measured = clusters.measured[known]
        self._cosine = _cosines(plan, paths)
        grid, carrier = np.linspace(0.0, 1.0, _COSINES), plan.radio.carrier_hz
        self._slabs = [(m, thickness) for m in config.materials for thickness in config.thickness_m]
        self._tables = [_table(plan, m, thickness, grid, carrier) for m, thickness in self._slabs]
        self._names = list(plan.surface_names)
        self._given = [_table(plan, s.material, s.thickness_m, grid, carrier) for s in plan.surface_slabs]
        gain = 10.0 ** (plan.gain_offsets_db()[paths.anchor] / 10.0)
        self._power = np.abs(paths.amplitude) ** 2 * gain

    def touches(self, name: str) -> bool:
        """Whether any measured cluster involves a wall."""
        return bool((self._walls == self._names.index(name)).any())

    def descend(self, free: Sequence[str], material: str | None) -> tuple[float, Slabs]:
        """Cost and slabs after a descent, wall by wall, from a material or (None) the plan's slabs."""
        config, power, now = self._config, self._power.copy(), list(self._given)
        chosen: dict[str, int] = {}
        if material is not None:
            count = len(config.thickness_m)
            middle = config.materials.index(material) * count + count // 2
            for name in free:
                power, now = self._changed(power, now, name, middle)
        result: Slabs = {}
        for floor in config.floors:
            most = config.most if floor == config.floors[-1] else np.inf
            for _ in range(config.rounds):
                before = dict(chosen)
                for name in free:
                    costs = self._costs(power, now, name, floor, most)
                    chosen[name] = int(np.argmin(costs))
                    result[name] = (*self._slabs[chosen[name]], _probabilities(costs, self._slabs, config))
                    power, now = self._changed(power, now, name, chosen[name])
                if chosen == before:
                    break
        cost = _cost(power, self._cluster, self._measured, config.floors[-1], config.most)
        return cost, result

    def _changed(self, power: Array, now: list[Array], name: str, slab: int) -> tuple[Array, list[Array]]:
        """Powers and tables after a wall's slab has changed."""
        wall = self._names.index(name)
        old = _factor(now[wall], self._walls, self._cosine, wall)
        new = _factor(self._tables[slab], self._walls, self._cosine, wall)
        return power * new / np.maximum(old, 1e-12), [
            self._tables[slab] if i == wall else table for i, table in enumerate(now)
        ]

    def _costs(self, power: Array, now: list[Array], name: str, floor: float, most: float) -> Array:
        """What each slab of a wall costs, the others being as they are."""
        wall = self._names.index(name)
        touched = np.zeros(len(self._measured), dtype=bool)
        touched[self._cluster[(self._walls == wall).any(axis=1)]] = True
        among = np.flatnonzero(touched[self._cluster])
        cluster = np.searchsorted(np.flatnonzero(touched), self._cluster[among])
        walls, cosine, measured = self._walls[among], self._cosine[among], self._measured[touched]
        bare = power[among] / np.maximum(_factor(now[wall], walls, cosine, wall), 1e-12)
        return np.array(
            [
                _cost(bare * _factor(table, walls, cosine, wall), cluster, measured, floor, most)
                for table in self._tables
            ]
        )


def _cosines(plan: FloorPlan, paths: PathList) -> Array:
    """Cosines of incidence (N, bounces) at the first and last bounce; the same at those between."""
    normal = surfaces_of(plan).normal
    leaving = directions_of(paths.departure_azimuth_rad, paths.departure_elevation_rad)
    arriving = directions_of(paths.arrival_azimuth_rad, paths.arrival_elevation_rad)
    cosine = np.ones(paths.walls.shape)
    for bounce in range(paths.walls.shape[1]):
        there = bounce < paths.order
        wall = np.where(there, paths.walls[:, bounce], 0)
        ray = leaving if bounce == 0 else arriving
        cosine[:, bounce] = np.where(there, np.abs(np.sum(ray * normal[wall], axis=1)), 1.0)
    return cosine


def _table(plan: FloorPlan, material: str, thickness_m: float, grid: Array, carrier_hz: float) -> Array:
    """Share of the power that a slab reflects over the cosine, waves polarised along it."""
    electric, _ = slab_reflection(grid, plan.permittivity_of(material, carrier_hz), thickness_m, carrier_hz)
    return np.asarray(np.abs(electric) ** 2)


def _factor(table: Array, walls: NDArray[np.int16], cosine: Array, wall: int) -> Array:
    """What a wall's slab makes of the power of each path (N,)."""
    place = cosine * (_COSINES - 1)
    low = np.minimum(place.astype(np.int64), _COSINES - 2)
    share = place - low
    value = (1.0 - share) * table[low] + share * table[low + 1]
    return np.asarray(np.prod(np.where(walls == wall, value, 1.0), axis=1))


def _cost(power: Array, cluster: Index, measured: Array, floor: float, most: float) -> float:
    """Negative log likelihood of measured powers, given the paths of each cluster."""
    mean = np.bincount(cluster, power, minlength=len(measured))
    square = np.bincount(cluster, power**2, minlength=len(measured))
    shape = 1.0 / (1.0 - square / mean**2 + floor**2)
    ratio = measured / mean
    # Gamma of that mean and shape k, over its peak: k (r - 1 - ln r) - ln(k) / 2 + ...
    cost = shape * (ratio - 1.0 - np.log(ratio)) - 0.5 * np.log(shape)
    return float(np.minimum(cost, most).sum())


def _probabilities(costs: Array, slabs: list[tuple[str, float]], config: ClusterFit) -> dict[str, float]:
    """Posterior of the materials, thicknesses being as likely before."""
    weight = np.exp(-config.tempering * (costs - costs.min()))
    total = {
        m: float(sum(w for w, s in zip(weight, slabs, strict=True) if s[0] == m)) for m in config.materials
    }
    return {material: value / sum(total.values()) for material, value in total.items()}
