"""Where paths bounce: their vertices, from the surfaces that they meet.

Files name the surfaces of a path and not its points; with the ends they determine them. So
traced paths, which single precision leaves hundredths of a degree and, at grazing incidence, a
tenth of a decibel off where a leg is short, are had in double precision, and a path is recognised
that names a surface beside the one it meets (of two walls in one plane, the tracer now and then
takes the neighbour).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.directions import angles_of
from raytrace.propagation.fields import specular_amplitude, specular_transfer
from raytrace.propagation.paths import NO_SURFACE, PathList
from raytrace.propagation.reflectors import mirrored, surfaces_of

__all__ = ["bounce_points", "sharpened"]

Array = NDArray[np.float64]


def bounce_points(
    plan: FloorPlan, paths: PathList, positions_m: Array, sources_m: Array | None = None
) -> Array:
    """Points at which specular paths bounce.

    Parameters
    ----------
    plan : FloorPlan
        The plan of the paths.
    paths : PathList
        The paths; ``epoch`` counts the positions, ``anchor`` the sources.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.
    sources_m : ndarray, shape (k, 3), optional
        Where paths begin, metres; by default the plan's anchors.

    Returns
    -------
    ndarray of float64, shape (paths, bounces, 3)
        From the anchor to the agent, plan frame, metres; NaN beyond a path's order.
    """
    surfaces = surfaces_of(plan)
    sources = plan.anchors_m() if sources_m is None else sources_m
    images = [sources[paths.anchor]]
    for wall in paths.walls.T:
        met = wall != NO_SURFACE
        images.append(np.where(met[:, None], mirrored(surfaces, images[-1], wall), images[-1]))
    points = np.full((*paths.walls.shape, 3), np.nan)
    point = positions_m[paths.epoch]
    for bounce in reversed(range(paths.walls.shape[1])):
        wall = paths.walls[:, bounce]
        normal, towards = surfaces.normal[wall], images[bounce + 1] - point
        gap = np.sum((surfaces.origin[wall] - point) * normal, axis=-1)
        slope = np.sum(towards * normal, axis=-1)
        met = wall != NO_SURFACE
        fraction = np.divide(gap, slope, out=np.zeros_like(gap), where=met)
        point = point + fraction[:, None] * towards
        points[met, bounce] = point[met]
    return points


def sharpened(
    plan: FloorPlan,
    paths: PathList,
    positions_m: Array,
    sources_m: Array,
    rim_m: float,
    carrier_hz: float,
    polarised: bool = False,
) -> PathList:
    """Traced paths in double precision, without those that bounce beside their surfaces.

    Delays, directions and gains are those of the surfaces that a path met.

    Parameters
    ----------
    plan, paths, positions_m, sources_m
        As for :func:`bounce_points`.
    rim_m : float
        By so much, measured across the ray, a bounce may miss its surface.
    carrier_hz : float
        Carrier of the gains, hertz.
    polarised : bool
        Compute ``PathList.transfer``, the gains between all polarisations, too.
    """
    paths, points = _on_their_surfaces(plan, paths, positions_m, sources_m, rim_m)
    agent, source = positions_m[paths.epoch], sources_m[paths.anchor]
    length, amplitude = np.empty(len(paths)), np.empty(len(paths), dtype=np.complex128)
    modes = 2 if polarised else 0
    transfer = np.empty((len(paths), modes, modes), dtype=np.complex128)
    ends = np.empty((2, len(paths), 3))  # where the path goes from the source, and comes from
    normals = surfaces_of(plan).normal
    for order in np.unique(paths.order):
        mine = np.flatnonzero(paths.order == order)
        vertices = np.concatenate([source[mine, None], points[mine, :order], agent[mine, None]], axis=1)
        walls = paths.walls[mine, :order].astype(np.int64)
        if polarised:
            transfer[mine] = specular_transfer(plan, vertices, walls, normals, carrier_hz)
            amplitude[mine] = transfer[mine, 0, 0]
        else:
            amplitude[mine] = specular_amplitude(plan, vertices, walls, normals, carrier_hz)
        length[mine] = np.linalg.norm(np.diff(vertices, axis=1), axis=-1).sum(axis=1)
        ends[:, mine] = vertices[:, 1], vertices[:, -2]
    departure, arrival = angles_of(ends[0] - source), angles_of(ends[1] - agent)
    return replace(
        paths,
        delay_s=length / SPEED_OF_LIGHT_M_S,
        amplitude=amplitude,
        departure_azimuth_rad=departure[0],
        departure_elevation_rad=departure[1],
        arrival_azimuth_rad=arrival[0],
        arrival_elevation_rad=arrival[1],
        transfer=transfer,
    )


def _on_their_surfaces(
    plan: FloorPlan, paths: PathList, positions_m: Array, sources_m: Array, rim_m: float
) -> tuple[PathList, Array]:
    """The paths that bounce on the surfaces they name, with :func:`bounce_points`."""
    surfaces = surfaces_of(plan)
    points = bounce_points(plan, paths, positions_m, sources_m)
    on, before = np.ones(len(paths), dtype=np.bool_), sources_m[paths.anchor]
    for bounce, wall in enumerate(paths.walls.T):
        met, point = wall != NO_SURFACE, points[:, bounce]
        leg = point - before
        along = np.einsum("nd,nsd->ns", point - surfaces.origin[wall], surfaces.sides[wall])
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.abs(np.sum(leg * surfaces.normal[wall], axis=-1))
            margin = (rim_m * np.linalg.norm(leg, axis=-1) / slope)[:, None]
        within = np.all((along >= -margin) & (along <= surfaces.lengths[wall] + margin), axis=-1)
        on &= within | ~met
        before = np.where(met[:, None], point, before)
    return paths.select(on), points[on]
