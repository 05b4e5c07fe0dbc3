"""The paper's echo: the radar equation (7) on the points that horizontal rays hit.

A ray that meets a surface after ``d`` at the angle ``psi`` from its normal returns

    Gamma(f) = b(f) / d^2 exp(-j 2 pi (f_c + f) 2 d / c),
    |b(f)|^2 = lambda(f)^2 gamma cos^(2 eta)(psi) / (4 pi)^3,                      (7)

times the two-way gain of the beam, (5) and (6). With pencil beams each beam has the
one ray at its centre: that is the paper's model. With the real beams a fan of rays goes
all around, and each beam weights it by its two-way pattern, normalised to one in power,
so that a fan that falls into a pencil gives the same.

    J. Yang, C.-K. Wen, S. Jin, "Hybrid Active and Passive Sensing for SLAM in
    Wireless Communication Systems".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.engine import ImageScene, Scene
from raytrace.propagation.reflectors import first_hits, surfaces_of
from raytrace.radio.channel import superpose

__all__ = ["horizontal_hits", "radar_sweep"]


def radar_sweep(
    plan: FloorPlan,
    radio: Scene,
    place_m: NDArray[np.float64],
    heading_rad: float,
    velocity_m_s: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """Noiseless sweep by the radar equation.

    Parameters
    ----------
    plan : FloorPlan
        ``plan.echo`` gives the beams, the tones, ``gamma``, ``eta`` and ``fan_rays``
        (rays of a whole turn; 0 for pencil beams).
    radio : RadioScene or ImageScene
        The scene.
    place_m : ndarray, shape (3,)
        Where the agent stands, metres.
    heading_rad : float
        Azimuth of its x axis in the plan, radians.
    velocity_m_s : ndarray, shape (3,)
        Its velocity, which turns returns from beam to beam, metres per second.

    Returns
    -------
    ndarray of complex128, shape (beams, tones)
    """
    echo = plan.echo
    beams, grid = echo.beams.beam_set(), echo.grid()
    centres = beams.azimuths()
    gain = np.diagonal(beams.two_way(centres))
    if echo.fan_rays:
        azimuth = 2.0 * np.pi * np.arange(echo.fan_rays) / echo.fan_rays
        pattern = beams.two_way(azimuth).T / gain[:, None]  # (beams, rays)
        share = pattern / np.linalg.norm(pattern, axis=1, keepdims=True)
    else:
        azimuth, share = centres, np.eye(beams.beams, dtype=np.complex128)
    distance, cosine = horizontal_hits(radio, place_m, azimuth + heading_rad)
    hit = np.isfinite(distance)
    distance, cosine = np.where(hit, distance, 1.0), np.where(hit, cosine, 0.0)
    section = echo.gamma * cosine ** (2.0 * echo.eta)
    carrier = np.exp(-2j * np.pi * echo.carrier_hz * 2.0 * distance / SPEED_OF_LIGHT_M_S)
    returned = np.where(hit, np.sqrt(section / (4.0 * np.pi) ** 3) / distance**2, 0.0) * carrier
    weights = gain[:, None] * share * returned
    if echo.beam_interval_s > 0.0:
        ahead = np.stack([np.cos(azimuth + heading_rad), np.sin(azimuth + heading_rad)], axis=-1)
        shift_hz = 2.0 * ahead @ velocity_m_s[:2] * echo.carrier_hz / SPEED_OF_LIGHT_M_S
        after_s = echo.beam_interval_s * np.arange(beams.beams)
        weights = weights * np.exp(2j * np.pi * after_s[:, None] * shift_hz)
    summed = superpose(weights, 2.0 * distance / SPEED_OF_LIGHT_M_S, grid)
    wavelength = SPEED_OF_LIGHT_M_S / (echo.carrier_hz + grid.offsets_hz())
    return np.asarray(summed * wavelength)


def horizontal_hits(
    radio: Scene, place_m: NDArray[np.float64], azimuth_rad: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where horizontal rays first meet the scene.

    Parameters
    ----------
    radio : RadioScene or ImageScene
        The scene.
    place_m : ndarray, shape (3,)
        Where the rays start, metres.
    azimuth_rad : ndarray, shape (n,)
        Their directions in the plan frame, radians.

    Returns
    -------
    distance_m : ndarray, shape (n,)
        Infinite where a ray meets nothing.
    cosine : ndarray, shape (n,)
        Cosine of the angle between ray and surface normal (0 where it meets nothing).
    """
    towards = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), np.zeros_like(azimuth_rad)])
    if isinstance(radio, ImageScene):
        return first_hits(surfaces_of(radio.plan), np.asarray(place_m, dtype=np.float64), towards.T)
    import mitsuba as mi

    origin = np.broadcast_to(radio.placed(np.asarray(place_m))[:, None], towards.shape)
    rays = mi.Ray3f(
        mi.Point3f(*(mi.Float(row.astype(np.float32)) for row in origin)),
        mi.Vector3f(*(mi.Float(row.astype(np.float32)) for row in towards)),
    )
    met = radio.scene.mi_scene.ray_intersect(rays)
    valid = np.array(met.is_valid().numpy(), dtype=bool)
    distance = np.where(valid, met.t.numpy().astype(np.float64), np.inf)
    normal = np.array(met.n.numpy(), dtype=np.float64).reshape(3, -1)
    cosine = np.where(valid, np.abs(np.sum(normal * towards, axis=0)), 0.0)
    return distance, cosine
