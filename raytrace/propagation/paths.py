"""Propagation paths as arrays of a fixed rank with a mask, in canonical order.

One :class:`PathSet` holds the paths from every anchor to every position of the
agent, whether they were traced (:mod:`raytrace.propagation.passive`) or constructed
(:mod:`raytrace.propagation.images`); so the two can be compared path by path.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "DIFFRACTION",
    "DIFFUSE",
    "NO_INTERACTION",
    "NO_SURFACE",
    "REFRACTION",
    "SPECULAR",
    "PathList",
    "PathSet",
]

NO_SURFACE = -1
# What a path does at a surface; numbers as those of Sionna RT.
NO_INTERACTION, SPECULAR, DIFFUSE, REFRACTION, DIFFRACTION = 0, 1, 2, 4, 8


@dataclass(frozen=True, eq=False)
class PathList:
    """Paths one after the other, in any order; every array has one row per path.

    Parameters
    ----------
    epoch, anchor : ndarray of int64, shape (n,)
        Position of the agent, and anchor, that the path joins.
    delay_s : ndarray of float64, shape (n,)
        Absolute time of flight, seconds.
    amplitude : ndarray of complex128, shape (n,)
        Gain between isotropic antennas with the phase at the carrier,
        ``exp(-j 2 pi f_c delay)`` included (dimensionless).
    departure_azimuth_rad, departure_elevation_rad : ndarray of float64, shape (n,)
        Direction in which the path leaves the anchor, plan frame, radians.
    arrival_azimuth_rad, arrival_elevation_rad : ndarray of float64, shape (n,)
        Direction from which it reaches the agent, plan frame, radians.
    order : ndarray of int16, shape (n,)
        Number of bounces, and of other interactions with surfaces.
    walls : ndarray of int16, shape (n, bounces)
        Surface of every bounce from the anchor to the agent, an index of
        ``FloorPlan.surface_names``; ``NO_SURFACE`` beyond ``order``.
    interactions : ndarray of int8, shape (n, bounces)
        What happens there: ``SPECULAR``, ``DIFFUSE``, ``REFRACTION`` or ``DIFFRACTION``;
        ``NO_INTERACTION`` beyond ``order``.
    transfer : ndarray of complex128, shape (n, 2, 2), or (n, 0, 0) if it was not traced
        Gain from each polarisation sent to each received, last axes (received, sent), each
        (zenith, azimuth): the unit vectors of spherical coordinates in the plan frame, in
        the direction of departure and in that of arrival. ``amplitude`` is its first entry.
    """

    epoch: NDArray[np.int64]
    anchor: NDArray[np.int64]
    delay_s: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    departure_azimuth_rad: NDArray[np.float64]
    departure_elevation_rad: NDArray[np.float64]
    arrival_azimuth_rad: NDArray[np.float64]
    arrival_elevation_rad: NDArray[np.float64]
    order: NDArray[np.int16]
    walls: NDArray[np.int16]
    interactions: NDArray[np.int8]
    transfer: NDArray[np.complex128]

    def __len__(self) -> int:
        return int(self.delay_s.size)

    def select(self, index: NDArray[np.bool_] | NDArray[np.int64]) -> PathList:
        """The paths of a mask or an index, in its order."""
        return PathList(**{field.name: getattr(self, field.name)[index] for field in fields(self)})

    @staticmethod
    def concatenate(parts: list[PathList]) -> PathList:
        """The paths of all ``parts``, one list after the other; the most bounces set the width."""
        columns = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(PathList)
            if field.name not in ("walls", "interactions")
        }
        bounces = max(part.walls.shape[1] for part in parts)

        def widened(values: NDArray[Any], empty: int) -> NDArray[Any]:
            return np.pad(values, ((0, 0), (0, bounces - values.shape[1])), constant_values=empty)

        walls = np.concatenate([widened(part.walls, NO_SURFACE) for part in parts])
        interactions = np.concatenate([widened(part.interactions, NO_INTERACTION) for part in parts])
        return PathList(**columns, walls=walls, interactions=interactions)

    @property
    def is_specular(self) -> NDArray[np.bool_]:
        """Which paths are lines of sight or bounce specularly alone, shape (n,)."""
        return np.asarray(np.isin(self.interactions, (NO_INTERACTION, SPECULAR)).all(axis=1))

    def keys(self, anchors: int, surfaces: int) -> NDArray[np.int64]:
        """A number for what identifies a specular path: epoch, anchor and walls; shape (n,).

        Numbers of two lists can be compared if they count the same anchors and
        surfaces and have columns for as many bounces.
        """
        key = self.epoch * anchors + self.anchor
        for wall in self.walls.T.astype(np.int64):
            key = key * (surfaces + 1) + (wall + 1)
        return key

    def canonical(self) -> PathList:
        """Sorted by epoch, anchor, delay, order, walls and interactions."""
        columns = [
            *self.interactions.T[::-1],
            *self.walls.T[::-1],
            self.order,
            self.delay_s,
            self.anchor,
            self.epoch,
        ]
        return self.select(np.lexsort(columns))


@dataclass(frozen=True, eq=False)
class PathSet:
    """Paths on a grid (epoch, anchor, path), sorted within each channel.

    Within a channel the order is that of :meth:`PathList.canonical`; slots that hold
    no path come last, have ``valid`` false, NaN in the real columns, zero amplitude
    and ``NO_SURFACE`` walls. Fields are those of :class:`PathList`, with the first
    three axes (epoch, anchor, path); ``walls`` and ``interactions`` have a fourth, bounce.
    """

    valid: NDArray[np.bool_]
    delay_s: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    departure_azimuth_rad: NDArray[np.float64]
    departure_elevation_rad: NDArray[np.float64]
    arrival_azimuth_rad: NDArray[np.float64]
    arrival_elevation_rad: NDArray[np.float64]
    order: NDArray[np.int16]
    walls: NDArray[np.int16]
    interactions: NDArray[np.int8]
    transfer: NDArray[np.complex128]

    @staticmethod
    def build(paths: PathList, epochs: int, anchors: int) -> PathSet:
        """Pad a list of paths to the rank of the fullest channel (at least one slot)."""
        paths = paths.canonical()
        channel = paths.epoch * anchors + paths.anchor
        counts = np.bincount(channel, minlength=epochs * anchors)
        shape = (epochs * anchors, max(int(counts.max(initial=0)), 1))
        slot = np.arange(len(paths)) - np.repeat(np.cumsum(counts) - counts, counts)

        def spread(values: NDArray[Any], empty: object) -> NDArray[Any]:
            grid = np.full((*shape, *values.shape[1:]), empty, dtype=values.dtype)
            grid[channel, slot] = values
            return grid.reshape(epochs, anchors, *grid.shape[1:])

        empty = {
            "amplitude": 0.0,
            "order": 0,
            "walls": NO_SURFACE,
            "interactions": NO_INTERACTION,
            "transfer": 0.0,
        }
        columns = {
            field.name: spread(getattr(paths, field.name), empty.get(field.name, np.nan))
            for field in fields(PathSet)
            if field.name != "valid"
        }
        return PathSet(valid=spread(np.ones(len(paths), dtype=np.bool_), False), **columns)

    def specular(self) -> PathSet:
        """Only the lines of sight and the paths that bounce specularly alone."""
        paths = self.flat()
        return PathSet.build(paths.select(paths.is_specular), *self.valid.shape[:2])

    def flat(self) -> PathList:
        """The paths one after the other, in canonical order."""
        epoch, anchor, _ = np.nonzero(self.valid)
        columns = {
            field.name: getattr(self, field.name)[self.valid]
            for field in fields(PathSet)
            if field.name != "valid"
        }
        return PathList(epoch=epoch, anchor=anchor, **columns)
