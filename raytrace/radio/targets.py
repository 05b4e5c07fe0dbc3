"""Echoes of point targets, by the radar equation.

A target of radar cross section ``sigma`` in sight, ``d_t`` from the transmitter and ``d_r``
from the receiver, returns between isotropic antennas

    |a|^2 = lambda^2 sigma / ((4 pi)^3 d_t^2 d_r^2),

with the phase of the way there and back. So a target at ``d`` falls as ``d^-4``, where a
wall's flash falls as ``d^-2``. What the target hides, and what it sends on to walls or
other targets, is left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.propagation.directions import angles_of
from raytrace.propagation.obstacles import blocked
from raytrace.propagation.paths import DIFFUSE, NO_SURFACE, PathList
from raytrace.propagation.reflectors import surfaces_of

__all__ = ["target_returns"]

Array = NDArray[np.float64]


def target_returns(plan: FloorPlan, sender_m: Array, receiver_m: Array) -> PathList:
    """Returns of the plan's targets that both ends see.

    Parameters
    ----------
    plan : FloorPlan
        ``plan.targets``, and the carrier of ``plan.echo``.
    sender_m, receiver_m : ndarray, shape (3,)
        Phase centres of the transmitting and the receiving beam, metres.

    Returns
    -------
    PathList
        One path for each target in sight, as if scattered once off no surface of the plan.
    """
    places = np.array([target.position_m for target in plan.targets]).reshape(-1, 3)
    section = np.array([target.section_m2 for target in plan.targets])
    ends = np.stack([np.broadcast_to(end, places.shape) for end in (sender_m, receiver_m)], axis=1)
    hidden = blocked(surfaces_of(plan), ends, places[:, None]).any(axis=1)
    places, section, ends = places[~hidden], section[~hidden], ends[~hidden]
    towards = places[:, None] - ends  # (target, end, xyz)
    there, back = np.linalg.norm(towards, axis=-1).T
    delay = (there + back) / SPEED_OF_LIGHT_M_S
    wavelength = SPEED_OF_LIGHT_M_S / plan.echo.carrier_hz
    gain = wavelength * np.sqrt(section / (4.0 * np.pi) ** 3) / (there * back)
    departure, arrival = angles_of(towards[:, 0]), angles_of(towards[:, 1])
    count = len(places)
    return PathList(
        epoch=np.zeros(count, dtype=np.int64),
        anchor=np.zeros(count, dtype=np.int64),
        delay_s=delay,
        amplitude=gain * np.exp(-2j * np.pi * plan.echo.carrier_hz * delay),
        departure_azimuth_rad=departure[0],
        departure_elevation_rad=departure[1],
        arrival_azimuth_rad=arrival[0],
        arrival_elevation_rad=arrival[1],
        order=np.ones(count, dtype=np.int16),
        walls=np.full((count, 1), NO_SURFACE, dtype=np.int16),
        interactions=np.full((count, 1), DIFFUSE, dtype=np.int8),
        transfer=np.zeros((count, 0, 0), dtype=np.complex128),
    )
