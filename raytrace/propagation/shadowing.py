"""What bodies in the rooms take from a path: knife edges, 3GPP TR 38.901, blockage model B.

A body is a box on the floor. Of each leg of a path it is a screen that stands across the leg, as wide as
the box looks from there; its four edges diffract, and the field is (clause 7.6.4.2)

    1 - (F_left + F_right) (F_above + F_below),   F = +-atan(pi/2 sqrt(pi / lambda (D1 + D2 - r))) / pi,

``r`` the leg, ``D1 + D2`` the way over the edge, positive where the leg passes the screen's side of the
edge. It depends on the geometry of paths alone, so that it is the same whichever engine found them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.targets import Target
from raytrace.propagation.bounces import bounce_points
from raytrace.propagation.directions import directions_of
from raytrace.propagation.paths import PathList

__all__ = ["shadow_of", "shadowed"]

Array = NDArray[np.float64]

# A leg that is shorter seen from above stands upright, and no screen is across it, metres.
_UPRIGHT_M = 1e-6
# A path that is longer than the straight line by less went straight through walls, metres.
_STRAIGHT_M = 1e-6


def shadowed(
    plan: FloorPlan,
    paths: PathList,
    positions_m: Array,
    times_s: Array,
    sources_m: Array | None = None,
    carrier_hz: float | None = None,
) -> PathList:
    """Paths as the plan's bodies leave them: the same, some weaker.

    Parameters
    ----------
    plan : FloorPlan
        ``plan.targets`` that have a size.
    paths : PathList
        ``epoch`` counts the positions, ``anchor`` the sources.
    positions_m : ndarray, shape (n, 3)
        Positions of the agent, metres.
    times_s : ndarray, shape (n,)
        Time at each since the first epoch, seconds.
    sources_m : ndarray, shape (k, 3), optional
        Where paths begin, metres; by default the plan's anchors.
    carrier_hz : float, optional
        Carrier, hertz; by default that of the plan's ``radio``.

    Returns
    -------
    PathList
        Paths that bend more than once pass bodies unhindered: where they bend is not kept.
    """
    bodies = [target for target in plan.targets if target.body_m is not None]
    if not bodies or not len(paths):
        return paths
    sources = plan.anchors_m() if sources_m is None else sources_m
    wavelength = SPEED_OF_LIGHT_M_S / (plan.radio.carrier_hz if carrier_hz is None else carrier_hz)
    vertices = _vertices(plan, paths, positions_m, sources)
    factor = np.ones(len(paths))
    for body in bodies:
        motion = body.motion(times_s)
        here, turned = motion.place_m[paths.epoch], motion.azimuth_rad[paths.epoch]
        for leg in range(vertices.shape[1] - 1):
            factor *= shadow_of(body, here, turned, vertices[:, leg], vertices[:, leg + 1], wavelength)
    return replace(paths, amplitude=paths.amplitude * factor, transfer=paths.transfer * factor[:, None, None])


def shadow_of(
    body: Target, place_m: Array, azimuth_rad: Array, start_m: Array, end_m: Array, wavelength_m: float
) -> Array:
    """What a body leaves of the field on a leg.

    Parameters
    ----------
    body : Target
        A target with a size.
    place_m, azimuth_rad : ndarray, shapes (n, 3) and (n,)
        Where it is, and where its front looks; metres, radians.
    start_m, end_m : ndarray, shape (n, 3)
        Ends of the legs, metres.
    wavelength_m : float
        Wavelength, metres.

    Returns
    -------
    ndarray, shape (n,)
        Factor of amplitudes.
    """
    length, width, height = body.body_m or (0.0, 0.0, 0.0)
    way = end_m - start_m
    level = np.linalg.norm(way[:, :2], axis=1)
    along = way[:, :2] / np.maximum(level, _UPRIGHT_M)[:, None]
    offset = place_m[:, :2] - start_m[:, :2]
    before = np.sum(offset * along, axis=1)
    aside = along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]
    looks = np.arctan2(along[:, 1], along[:, 0]) - azimuth_rad
    half = 0.5 * (length * np.abs(np.sin(looks)) + width * np.abs(np.cos(looks)))
    share = before / np.maximum(level, _UPRIGHT_M)
    rise = start_m[:, 2] + share * way[:, 2]
    foot = place_m[:, 2] + body.foot_m
    after = level - before
    sides = [_edge(gap, before, after, gap, gap, level, wavelength_m) for gap in (half + aside, half - aside)]
    whole = np.linalg.norm(way, axis=1)
    for edge, gap in ((foot + height, foot + height - rise), (foot, rise - foot)):
        sides.append(_edge(gap, before, after, edge - start_m[:, 2], edge - end_m[:, 2], whole, wavelength_m))
    factor = 1.0 - (sides[0] + sides[1]) * (sides[2] + sides[3])
    crossed = (level > _UPRIGHT_M) & (share > 0.0) & (share < 1.0)
    return np.where(crossed, np.clip(factor, 0.0, None), 1.0)


def _edge(
    gap: Array, before: Array, after: Array, rise1: Array, rise2: Array, direct: Array, wavelength_m: float
) -> Array:
    """``F`` of an edge: how far the leg passes on the screen's side of it, and the way over the edge."""
    detour = np.hypot(before, rise1) + np.hypot(after, rise2) - direct
    bend = np.arctan(0.5 * np.pi * np.sqrt(np.pi / wavelength_m * np.maximum(detour, 0.0))) / np.pi
    return np.asarray(np.sign(gap) * bend)


def _vertices(plan: FloorPlan, paths: PathList, positions_m: Array, sources_m: Array) -> Array:
    """Vertices of paths from source to agent, (n, bounces + 2, 3); beyond the last bounce the agent's place.

    Of paths that bend once the point follows from delay and direction; of those that bend more often
    there are none, and all vertices are the source's.
    """
    agent, source = positions_m[paths.epoch], sources_m[paths.anchor]
    bent = ~paths.is_specular
    points = np.full((*paths.walls.shape, 3), np.nan)
    points[~bent] = bounce_points(plan, paths.select(~bent), positions_m, sources_m)
    vertices = np.concatenate([source[:, None], points, agent[:, None]], axis=1)
    if bent.any():
        there = source[bent] - agent[bent]
        straight, whole = np.linalg.norm(there, axis=1), paths.delay_s[bent] * SPEED_OF_LIGHT_M_S
        back = directions_of(paths.arrival_azimuth_rad[bent], paths.arrival_elevation_rad[bent])
        gap = np.maximum(whole - np.sum(back * there, axis=1), _STRAIGHT_M)
        point = agent[bent] + ((whole**2 - straight**2) / (2.0 * gap))[:, None] * back
        through = whole - straight < _STRAIGHT_M
        known = through | (paths.order[bent] <= 1)
        vertices[bent, 1] = np.where(through[:, None], agent[bent], point)
        vertices[np.flatnonzero(bent)[~known]] = source[bent][~known, None]
    return np.where(np.isnan(vertices), agent[:, None], vertices)
