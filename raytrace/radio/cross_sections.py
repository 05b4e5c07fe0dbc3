"""Radar cross sections of people, vehicles and AGVs: 3GPP TR 38.901, clause 7.9.2.1 (Release 19).

A scattering point has lobes, each with its largest value ``G`` and dynamic range ``S`` in decibels (over a
square metre). With ``theta`` and ``phi`` zenith and azimuth of the bisector between the directions
to transmitter and receiver in the body's axes, and ``beta`` the angle between these, (7.9.2-3) is

    10 lg(sigma) = max(G - min(12 (dtheta / theta_3dB)^2 + 12 (dphi / phi_3dB)^2, S)
                       - k1 sin(k2 beta / 2) + 5 lg(cos(beta / 2)),  G - S),

each of the two terms at most ``S``. Of a person the lobe is chosen by the bisector (Table 7.9.2.1-3, RCS
model 2); vehicles and AGVs have a point on each side and on top (Tables 7.9.2.1-5 and -7). The random
component of the cross section is left at its mean of one, and polarisation is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.targets import Target
from raytrace.propagation.directions import angles_of

__all__ = ["scattering_points", "sections_m2"]

Array = NDArray[np.float64]

# Where a person scatters, over the height: 1.5 m of 1.75 m (Table 7.9.6.1-2).
_CHEST = 1.5 / 1.75
# At forward scattering cos(beta / 2) vanishes and the floor G - S counts.
_LEAST_COSINE = 1e-6


@dataclass(frozen=True)
class _Lobe:
    """Centre and width of a lobe in azimuth (None: all around) and zenith, degrees; peak and range, dB."""

    azimuth_deg: float | None
    azimuth_width_deg: float
    zenith_deg: float
    zenith_width_deg: float
    peak_db: float
    range_db: float


@dataclass(frozen=True)
class _Kind:
    """Lobes of a kind; whether each has a point of its own; k1 and k2."""

    lobes: tuple[_Lobe, ...]
    apart: bool
    k1: float
    k2: float


_KINDS = {
    "human": _Kind(
        (_Lobe(0.0, 216.65, 90.0, 55.7, 2.14, 7.7), _Lobe(180.0, 216.65, 90.0, 55.7, 2.14, 7.7)),
        False,
        0.5714,
        0.1,
    ),
    "vehicle": _Kind(
        (
            _Lobe(90.0, 26.90, 79.70, 44.42, 20.60, 20.52),
            _Lobe(180.0, 36.32, 79.65, 36.73, 13.90, 13.82),
            _Lobe(270.0, 26.90, 79.70, 44.42, 20.60, 20.52),
            _Lobe(0.0, 40.54, 71.75, 29.13, 14.99, 14.91),
            _Lobe(None, 0.0, 0.0, 18.13, 21.12, 21.05),
        ),
        True,
        6.0,
        1.65,
    ),
    "agv": _Kind(
        (
            _Lobe(0.0, 13.68, 90.0, 13.68, 13.00, 30.26),
            _Lobe(90.0, 15.53, 75.0, 20.03, 7.27, 24.53),
            _Lobe(180.0, 12.49, 90.0, 11.89, 10.98, 28.24),
            _Lobe(270.0, 15.53, 75.0, 20.03, 7.27, 24.53),
            _Lobe(None, 0.0, 0.0, 11.44, 11.77, 29.03),
        ),
        True,
        12.0,
        1.45,
    ),
}


def scattering_points(target: Target) -> Array:
    """Where a target scatters in its own axes (x ahead, z up from where it is), shape (points, 3), metres."""
    if target.kind == "point":
        return np.array(target.points_m, dtype=np.float64)
    length, width, height = target.body_m or (0.0, 0.0, 0.0)
    kind = _KINDS[target.kind]
    if not kind.apart:
        return np.array([[0.0, 0.0, _CHEST * height]])
    points = []
    for lobe in kind.lobes:  # in the middle of the face that it stands for
        if lobe.azimuth_deg is None:
            points.append((0.0, 0.0, height))
        else:
            turn = np.deg2rad(lobe.azimuth_deg)
            points.append((0.5 * length * np.cos(turn), 0.5 * width * np.sin(turn), 0.5 * height))
    return np.array(points)


def sections_m2(target: Target, to_sender: Array, to_receiver: Array) -> Array:
    """Cross sections of a target's points.

    Parameters
    ----------
    target : Target
        The target.
    to_sender, to_receiver : ndarray, shape (..., points, 3)
        Unit vectors from each point to transmitter and receiver, in the target's axes.

    Returns
    -------
    ndarray, shape (..., points)
        Square metres.
    """
    if target.kind == "point":
        return np.full(to_sender.shape[:-1], target.section_m2 / len(target.points_m))
    kind = _KINDS[target.kind]
    bisector = to_sender + to_receiver
    half_cosine = 0.5 * np.linalg.norm(bisector, axis=-1)
    half_sine = 0.5 * np.linalg.norm(to_sender - to_receiver, axis=-1)
    beta = 2.0 * np.arctan2(half_sine, half_cosine)
    azimuth, elevation = (np.rad2deg(angle) for angle in angles_of(bisector))
    zenith = 90.0 - elevation
    bent_db = -kind.k1 * np.sin(0.5 * kind.k2 * beta) + 5.0 * np.log10(np.maximum(half_cosine, _LEAST_COSINE))
    values = [_pattern_db(lobe, azimuth, zenith) + bent_db for lobe in kind.lobes]
    floored = [
        np.maximum(value, lobe.peak_db - lobe.range_db)
        for value, lobe in zip(values, kind.lobes, strict=True)
    ]
    if kind.apart:  # point k has lobe k
        section_db = np.stack([value[..., k] for k, value in enumerate(floored)], axis=-1)
    else:  # the front's, or the back's
        section_db = np.where(np.abs(azimuth) < 90.0, floored[0], floored[1])
    return np.asarray(10.0 ** (section_db / 10.0))


def _pattern_db(lobe: _Lobe, azimuth_deg: Array, zenith_deg: Array) -> Array:
    """The lobe's value without the bistatic terms, decibels over a square metre."""
    fall = np.minimum(12.0 * ((zenith_deg - lobe.zenith_deg) / lobe.zenith_width_deg) ** 2, lobe.range_db)
    if lobe.azimuth_deg is not None:
        off = np.mod(azimuth_deg - lobe.azimuth_deg + 180.0, 360.0) - 180.0
        fall = fall + np.minimum(12.0 * (off / lobe.azimuth_width_deg) ** 2, lobe.range_db)
    return np.asarray(lobe.peak_db - np.minimum(fall, lobe.range_db))
