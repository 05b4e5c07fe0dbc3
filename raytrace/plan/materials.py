"""Building materials: permittivity and the reflection of a slab.

Permittivity and conductivity follow Recommendation ITU-R P.2040-4 (Table 3), which
gives, for a frequency ``f`` in GHz inside a material's range,

    eps_r = a f^b,    sigma = c f^d  (S/m).

Reflection and transmission are those of a single slab in air, (37), (43) and (44) of the same
recommendation. All of it is plain NumPy, so that a floor plan can be validated, and
a traced amplitude checked, on a machine that has no ray tracer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S

__all__ = [
    "ITU_MATERIALS",
    "frequency_ranges_hz",
    "permittivity",
    "relative_permittivity",
    "slab_reflection",
    "slab_transmission",
]

_VACUUM_PERMITTIVITY_F_M = 8.854_187_812_8e-12

# Table 3 of ITU-R P.2040-4: ((lowest GHz, highest GHz), (a, b, c, d)), the lowest range first
# where ranges do not overlap; where they do, the first that holds the frequency counts.
ITU_MATERIALS: dict[str, tuple[tuple[tuple[float, float], tuple[float, float, float, float]], ...]] = {
    "vacuum": (((0.001, 100.0), (1.0, 0.0, 0.0, 0.0)),),
    "concrete": (
        ((1.0, 100.0), (5.24, 0.0, 0.0462, 0.7822)),
        ((110.0, 330.0), (5.17, 0.0, 0.0145, 1.09)),
    ),
    "brick": (((1.0, 40.0), (3.91, 0.0, 0.0238, 0.16)), ((110.0, 330.0), (4.15, 0.0, 0.0006, 1.5712))),
    "plasterboard": (
        ((1.0, 100.0), (2.73, 0.0, 0.0085, 0.9395)),
        ((110.0, 330.0), (2.56, 0.0, 0.0001, 1.7799)),
        ((100.0, 400.0), (2.65, 0.0, 0.0002, 1.598)),
    ),
    "wood": (
        ((0.001, 100.0), (1.99, 0.0, 0.0047, 1.0718)),
        ((110.0, 330.0), (1.82, 0.0, 0.004, 1.0761)),
        ((100.0, 400.0), (2.1183, 0.0, 0.0055, 1.1113)),
    ),
    "glass": (
        ((0.1, 100.0), (6.31, 0.0, 0.0036, 1.3394)),
        ((220.0, 450.0), (5.79, 0.0, 0.0004, 1.658)),
        ((100.0, 400.0), (6.5767, 0.0, 0.0012, 1.4697)),
    ),
    "clear_acrylic": (((110.0, 330.0), (2.58, 0.0, 0.0001, 1.6524)),),
    "ceiling_board": (
        ((1.0, 100.0), (1.48, 0.0, 0.0011, 1.075)),
        ((220.0, 450.0), (1.52, 0.0, 0.0029, 1.029)),
        ((100.0, 400.0), (1.2567, 0.0, 0.00013, 1.454)),
    ),
    "chipboard": (
        ((1.0, 100.0), (2.58, 0.0, 0.0217, 0.78)),
        ((100.0, 200.0), (2.16, 0.0, 0.0023, 1.359)),
    ),
    "plywood": (
        ((1.0, 40.0), (2.71, 0.0, 0.33, 0.0)),
        ((110.0, 330.0), (1.94, 0.0, 0.0067, 0.9982)),
        ((100.0, 400.0), (2.17, 0.0, 0.0063, 1.045)),
    ),
    "marble": (
        ((1.0, 60.0), (7.074, 0.0, 0.0055, 0.9262)),
        ((110.0, 330.0), (7.94, 0.0, 0.0001, 1.733)),
        ((100.0, 400.0), (8.62, 0.0, 0.0027, 1.15)),
    ),
    "floorboard": (
        ((50.0, 100.0), (3.66, 0.0, 0.0044, 1.3515)),
        ((220.0, 300.0), (5.27, 0.0, 2.22e-17, 7.3413)),
        ((300.0, 400.0), (5.27, 0.0, 0.0003, 2.0298)),
        ((400.0, 450.0), (5.27, 0.0, 49.8726, 0.0)),
        ((100.0, 400.0), (3.1575, 0.0, 0.001675, 1.32775)),
    ),
    "vinyl_tile": (((1.0, 40.0), (3.62, 0.0, 0.0051, 0.8422)),),
    "carpet_tile": (((1.0, 40.0), (2.08, 0.0, 0.0009, 0.82)),),
    "asphalt_concrete": (((1.0, 40.0), (4.83, 0.0, 0.0108, 1.3969)),),
    "metal": (((1.0, 100.0), (1.0, 0.0, 1e7, 0.0)),),
    "very_dry_ground": (((1.0, 10.0), (3.0, 0.0, 0.00015, 2.52)),),
    "medium_dry_ground": (((1.0, 10.0), (15.0, -0.1, 0.035, 1.63)),),
    "wet_ground": (((1.0, 10.0), (30.0, -0.4, 0.15, 1.3)),),
}


def frequency_ranges_hz(material: str) -> list[tuple[float, float]]:
    """Frequency ranges in which a material is defined, in hertz, in the table's order.

    Raises
    ------
    InputError
        If the material is not in the table.
    """
    if material not in ITU_MATERIALS:
        raise InputError(f"material: expected one of {', '.join(ITU_MATERIALS)}, got {material!r}")
    return [(low * 1e9, high * 1e9) for (low, high), _ in ITU_MATERIALS[material]]


def permittivity(material: str, frequency_hz: float) -> complex:
    """Complex relative permittivity ``eps_r - j sigma / (omega eps_0)``.

    Parameters
    ----------
    material : str
        A name of :data:`ITU_MATERIALS`.
    frequency_hz : float
        Frequency, hertz.

    Raises
    ------
    InputError
        If the material is unknown, or not defined at this frequency.
    """
    ranges = frequency_ranges_hz(material)
    frequency_ghz = frequency_hz / 1e9
    for (low, high), (a, b, c, d) in ITU_MATERIALS[material]:
        if low <= frequency_ghz <= high:
            conductivity = c * frequency_ghz**d
            return relative_permittivity(a * frequency_ghz**b, conductivity, frequency_hz)
    wanted = " or ".join(f"{low / 1e9:g} to {high / 1e9:g} GHz" for low, high in ranges)
    raise InputError(f"{material}: expected a frequency of {wanted}, got {frequency_ghz:g} GHz")


def relative_permittivity(real: float, conductivity_s_m: float, frequency_hz: float) -> complex:
    """``eps_r - j sigma / (omega eps_0)`` from its real part and a conductivity, siemens per metre."""
    return complex(real, -conductivity_s_m / (2.0 * np.pi * frequency_hz * _VACUUM_PERMITTIVITY_F_M))


def slab_reflection(
    cosine: ArrayLike, relative_permittivity: complex, thickness_m: float, frequency_hz: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Reflection coefficients of a slab in air, ITU-R P.2040-4 (43a).

    Parameters
    ----------
    cosine : array_like
        Cosine of the angle between the incident ray and the normal, any shape.
    relative_permittivity : complex
        Complex relative permittivity, negative imaginary part.
    thickness_m : float
        Thickness, metres.
    frequency_hz : float
        Frequency, hertz.

    Returns
    -------
    transverse_electric, transverse_magnetic : ndarray of complex128
        Coefficients for the field normal to, and in, the plane of incidence; the
        shape of ``cosine``. The sign of the latter is that of (37b): at normal
        incidence the two are opposite.
    """
    cosine = np.asarray(cosine, dtype=np.float64)
    root = np.sqrt(relative_permittivity - (1.0 - cosine**2))
    single_te = (cosine - root) / (cosine + root)  # (37a)
    single_tm = (relative_permittivity * cosine - root) / (relative_permittivity * cosine + root)  # (37b)
    q = 2.0 * np.pi * thickness_m * frequency_hz / SPEED_OF_LIGHT_M_S * root  # (44)
    round_trip = np.exp(-2j * q)
    transverse_electric, transverse_magnetic = (
        np.asarray(single * (1.0 - round_trip) / (1.0 - single**2 * round_trip))  # (43a)
        for single in (single_te, single_tm)
    )
    return transverse_electric, transverse_magnetic


def slab_transmission(
    cosine: ArrayLike, relative_permittivity: complex, thickness_m: float, frequency_hz: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Transmission coefficients of a slab in air, ITU-R P.2040-4 (43b); as :func:`slab_reflection`."""
    cosine = np.asarray(cosine, dtype=np.float64)
    root = np.sqrt(relative_permittivity - (1.0 - cosine**2))
    single_te = (cosine - root) / (cosine + root)  # (37a)
    single_tm = (relative_permittivity * cosine - root) / (relative_permittivity * cosine + root)  # (37b)
    once = np.exp(-2j * np.pi * thickness_m * frequency_hz / SPEED_OF_LIGHT_M_S * root)  # (44)
    transverse_electric, transverse_magnetic = (
        np.asarray((1.0 - single**2) * once / (1.0 - single**2 * once**2))  # (43b)
        for single in (single_te, single_tm)
    )
    return transverse_electric, transverse_magnetic
