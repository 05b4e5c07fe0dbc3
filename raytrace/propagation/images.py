"""The image method: all specular paths of a floor plan, exactly.

The anchor is mirrored in a sequence of surfaces; the path is unfolded backward from
the agent, each bounce where the line to the image meets its surface. A path exists
if every bounce falls on its finite surface and no leg is blocked. This is the
two-dimensional equation (2) of the paper in three dimensions, with visibility.

It shares nothing with the ray tracer, in double precision, and so proves that the
tracer lost no path; it also serves where paths are needed without Mitsuba. Its cost
grows as the number of sequences of surfaces that a beam from the anchor can take, with walls
hiding one another (:mod:`raytrace.propagation.sequences`), not with the size of the building.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.beams import within_beams
from raytrace.propagation.directions import angles_of
from raytrace.propagation.fields import specular_amplitude, specular_transfer
from raytrace.propagation.obstacles import blocked
from raytrace.propagation.paths import NO_INTERACTION, NO_SURFACE, SPECULAR, PathList, PathSet
from raytrace.propagation.reflectors import RIM_M, TIP, Surfaces, on_rectangle, surfaces_of
from raytrace.propagation.sequences import Sequences, chosen_sequences, lit_sequences

__all__ = ["image_paths"]

Array = NDArray[np.float64]

# Pairs of a position and a sequence of surfaces looked at together: what is written about them stays in
# the processor's cache.
_PAIRS = 60_000


def image_paths(
    plan: FloorPlan,
    positions_m: ArrayLike | None = None,
    depth: int | None = None,
    anchors_m: ArrayLike | None = None,
    rim_m: float = RIM_M,
    leg_m: float = 0.0,
    among: NDArray[np.int16] | None = None,
    carrier_hz: float | None = None,
    polarised: bool = False,
) -> PathSet:
    """All specular paths from every anchor to every position.

    Parameters
    ----------
    plan : FloorPlan
        Walls, floor, ceiling and their materials.
    positions_m : array_like, shape (n, 3), optional
        Positions of the agent, metres; by default the plan's track.
    depth : int, optional
        Most bounces; by default the plan's ``tracing.depth``.
    anchors_m : array_like, shape (k, 3), optional
        Anchors, metres; by default the plan's.
    rim_m : float
        Paths that bounce closer than this to the rim of a surface, or pass closer by
        one, are left out: there the rim decides, not the surface. If it is negative, those
        are included that miss a surface, or an opening, by no more. It is measured across
        the ray: along a surface that is grazed it is longer.
    leg_m : float
        Paths with a leg shorter than this are left out: both its ends are at one corner.
    among : ndarray of int16, shape (n, bounces), optional
        Only paths that bounce on one of these sequences of surfaces, as ``PathList.walls``.
    carrier_hz : float, optional
        Carrier of the gains, hertz; by default that of the plan's ``radio``.
    polarised : bool
        Compute ``PathList.transfer``, the gains between all polarisations, too.

    Returns
    -------
    PathSet
        Axes (n, k, path).
    """
    positions = plan.track() if positions_m is None else np.asarray(positions_m, dtype=np.float64)
    anchors = plan.anchors_m() if anchors_m is None else np.asarray(anchors_m, dtype=np.float64)
    depth = plan.tracing.depth if depth is None else depth
    gain = _Gain(plan, plan.radio.carrier_hz if carrier_hz is None else carrier_hz, polarised)
    surfaces = surfaces_of(plan)
    parts = []
    for index, anchor in enumerate(anchors):
        of_orders = (
            lit_sequences(surfaces, anchor, depth, _top_m(plan, positions, anchor), blind=rim_m < 0.0)
            if among is None
            else (chosen_sequences(surfaces, anchor, among, order) for order in range(depth + 1))
        )
        for sequences in of_orders:
            found = _visible(surfaces, positions, sequences, rim_m, leg_m)
            parts.append(_path_list(gain, surfaces, index, max(depth, 1), *found))
    return PathSet.build(PathList.concatenate(parts), len(positions), len(anchors))


def _top_m(plan: FloorPlan, positions: Array, anchor: Array) -> float:
    """Height that no path exceeds, metres; infinite where paths may pass below the walls."""
    ends = np.append(positions[:, 2], anchor[2])
    if ends.min(initial=0.0) < 0.0:
        return float(np.inf)
    return float(max(ends.max(), plan.ceiling_height_m if plan.has_ceiling else 0.0))


def _visible(
    surfaces: Surfaces,
    positions: Array,
    sequences: Sequences,
    rim_m: float,
    leg_m: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Paths of sequences to positions (n, 3) that nothing blocks.

    Returns the position's index, the surfaces (paths, order), and the vertices from anchor to
    agent (paths, order + 2, 3).
    """
    block = max(1, _PAIRS // max(1, len(sequences)))
    parts = [
        (row, epoch + first, vertices)
        for first in range(0, len(positions), block)
        for epoch, row, vertices in (_unfold(surfaces, positions[first : first + block], sequences, rim_m),)
    ]
    row, epoch, vertices = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    clear = np.all(np.linalg.norm(np.diff(vertices, axis=1), axis=-1) >= leg_m, axis=1)
    met = np.pad(sequences.surfaces[row], ((0, 0), (1, 1)), constant_values=-1)
    ends = np.stack([met[:, :-1], met[:, 1:]], axis=2)
    for leg in range(vertices.shape[1] - 1):  # what the first leg ends is not asked for the next
        left = np.flatnonzero(clear)
        clear[left] = ~blocked(surfaces, vertices[left, leg], vertices[left, leg + 1], rim_m, ends[left, leg])
    return epoch[clear], sequences.surfaces[row[clear]], vertices[clear]


@dataclass(frozen=True)
class _Gain:
    """Which gains of paths are wanted."""

    plan: FloorPlan
    carrier_hz: float
    polarised: bool

    def of(
        self, vertices: Array, hit: NDArray[np.int64], normal: Array
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """``PathList.amplitude`` and ``PathList.transfer`` of paths of one order."""
        if self.polarised:
            transfer = specular_transfer(self.plan, vertices, hit, normal, self.carrier_hz)
            return transfer[:, 0, 0], transfer
        amplitude = specular_amplitude(self.plan, vertices, hit, normal, self.carrier_hz)
        return amplitude, np.zeros((len(hit), 0, 0), dtype=np.complex128)


def _path_list(
    gain: _Gain,
    surfaces: Surfaces,
    anchor: int,
    bounces: int,
    epoch: NDArray[np.int64],
    hit: NDArray[np.int64],
    vertices: Array,
) -> PathList:
    """Paths of one order, with columns for some bounces, from what :func:`_visible` found."""
    order = hit.shape[1]
    length = np.linalg.norm(np.diff(vertices, axis=1), axis=-1).sum(axis=1)
    departure = angles_of(vertices[:, 1] - vertices[:, 0])
    arrival = angles_of(vertices[:, -2] - vertices[:, -1])
    walls = np.full((len(epoch), bounces), NO_SURFACE, dtype=np.int16)
    walls[:, :order] = hit
    amplitude, transfer = gain.of(vertices, hit, surfaces.normal)
    return PathList(
        epoch=epoch,
        anchor=np.full(len(epoch), anchor, dtype=np.int64),
        delay_s=length / SPEED_OF_LIGHT_M_S,
        amplitude=amplitude,
        departure_azimuth_rad=departure[0],
        departure_elevation_rad=departure[1],
        arrival_azimuth_rad=arrival[0],
        arrival_elevation_rad=arrival[1],
        order=np.full(len(epoch), order, dtype=np.int16),
        walls=walls,
        interactions=np.where(walls == NO_SURFACE, NO_INTERACTION, SPECULAR).astype(np.int8),
        transfer=transfer,
    )


def _unfold(
    surfaces: Surfaces, positions: Array, sequences: Sequences, rim_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Bounces of every sequence seen from every position (n, 3), those on their surfaces.

    Returns the position's index, the sequence's, and the vertices from anchor to agent
    (paths, order + 2, 3).
    """
    epoch, row = _near_last(surfaces, positions, sequences, rim_m)
    vertices = [positions[epoch]]
    for bounce in reversed(range(sequences.surfaces.shape[1])):
        wall = sequences.surfaces[row, bounce]
        towards = sequences.images[row, bounce + 1] - vertices[0]
        normal = surfaces.normal[wall]
        slope = np.sum(towards * normal, axis=-1)
        gap = np.sum((surfaces.origin[wall] - vertices[0]) * normal, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = gap / slope
            margin = -rim_m * np.linalg.norm(towards, axis=-1) / np.abs(slope)
        point = vertices[0] + np.where(np.isfinite(fraction), fraction, 0.0)[:, None] * towards
        on = (fraction > TIP) & (fraction < 1.0 - TIP) & on_rectangle(surfaces, wall, point, margin)
        epoch, row = epoch[on], row[on]
        vertices = [point[on], *(vertex[on] for vertex in vertices)]
    return epoch, row, np.stack([sequences.images[row, 0], *vertices], axis=1)


def _near_last(
    surfaces: Surfaces, positions: Array, sequences: Sequences, rim_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Positions (n, 3) and sequences whose last image is seen through the last surface, or nearly so.

    A first look that is quick: every position is asked about every sequence.
    """
    if not sequences.surfaces.shape[1]:
        epoch, row = np.nonzero(np.ones((len(positions), len(sequences)), dtype=bool))
        return epoch, row
    return within_beams(
        surfaces.origin,
        surfaces.sides,
        surfaces.lengths,
        surfaces.normal,
        np.ascontiguousarray(positions, dtype=np.float64),
        np.ascontiguousarray(sequences.images[:, -1]),
        np.ascontiguousarray(sequences.surfaces[:, -1]),
        sequences.wall,
        sequences.spans_m,
        rim_m,
    )
