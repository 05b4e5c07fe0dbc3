"""The gain of a specular path: free space, and a slab's reflection at each bounce.

The field starts as that of an isotropic, vertically or horizontally polarised antenna, is
turned and weakened at every bounce by the coefficients of :func:`raytrace.plan.materials.slab_reflection`
in the plane of incidence, and is received by the same kinds of antenna. Written from
the textbook, independently of the ray tracer, to check it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.waveform import SPEED_OF_LIGHT_M_S
from raytrace.plan.floorplan import FloorPlan
from raytrace.plan.materials import slab_reflection
from raytrace.propagation.directions import spherical_basis

__all__ = ["specular_amplitude", "specular_transfer"]

Array = NDArray[np.float64]


def specular_amplitude(
    plan: FloorPlan, vertices_m: Array, surfaces: NDArray[np.int64], normals: Array, carrier_hz: float
) -> NDArray[np.complex128]:
    """Amplitudes of specular paths of one order.

    Parameters
    ----------
    plan : FloorPlan
        Gives the material, thickness and scattering coefficient of each surface.
    vertices_m : ndarray, shape (n, order + 2, 3)
        Anchor, reflection points and agent, metres.
    surfaces : ndarray of int64, shape (n, order)
        Surface of each bounce.
    normals : ndarray, shape (surfaces, 3)
        Unit normal of every surface, either way.
    carrier_hz : float
        Frequency, hertz.

    Returns
    -------
    ndarray of complex128, shape (n,)
        ``lambda / (4 pi d)`` times the polarised reflections and ``exp(-j 2 pi f d / c)``.
    """
    return _transfer(plan, vertices_m, surfaces, normals, carrier_hz, modes=1)[:, 0, 0]


def specular_transfer(
    plan: FloorPlan, vertices_m: Array, surfaces: NDArray[np.int64], normals: Array, carrier_hz: float
) -> NDArray[np.complex128]:
    """Gains between all polarisations, as ``PathList.transfer``, of specular paths of one order.

    Parameters are those of :func:`specular_amplitude`.

    Returns
    -------
    ndarray of complex128, shape (n, 2, 2)
        Axes (path, received, sent), each (zenith, azimuth).
    """
    return _transfer(plan, vertices_m, surfaces, normals, carrier_hz, modes=2)


def _transfer(
    plan: FloorPlan,
    vertices_m: Array,
    surfaces: NDArray[np.int64],
    normals: Array,
    carrier_hz: float,
    modes: int,
) -> NDArray[np.complex128]:
    """Gains of the first polarisations sent, (n, 2, modes)."""
    legs = np.diff(vertices_m, axis=1)
    lengths = np.linalg.norm(legs, axis=-1)
    directions = legs / lengths[..., None]
    sent, received = spherical_basis(directions[:, 0]), spherical_basis(-directions[:, -1])
    columns = []
    for mode in range(modes):
        field = sent[:, mode].astype(np.complex128)
        for bounce in range(surfaces.shape[1]):
            field = _reflect(
                plan,
                field,
                directions[:, bounce],
                directions[:, bounce + 1],
                surfaces[:, bounce],
                normals,
                carrier_hz,
            )
        columns.append(np.einsum("nrd,nd->nr", received, field))
    distance = lengths.sum(axis=1)
    wavelength = SPEED_OF_LIGHT_M_S / carrier_hz
    free_space = wavelength / (4.0 * np.pi * distance) * np.exp(-2j * np.pi * distance / wavelength)
    return np.asarray(free_space[:, None, None] * np.stack(columns, axis=-1))


def _reflect(
    plan: FloorPlan,
    field: NDArray[np.complex128],
    incident: Array,
    outgoing: Array,
    surface: NDArray[np.int64],
    normals: Array,
    carrier_hz: float,
) -> NDArray[np.complex128]:
    """Split the field along the plane of incidence, reflect both parts, and join them."""
    normal = normals[surface]
    across = np.cross(incident, normal)
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    # At normal incidence every direction across serves: take one normal to the field's vertical part.
    spare = np.cross(_any_other(normal), normal)
    across = np.where(size > 1e-9, across, spare)
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    cosine = np.abs(np.sum(incident * normal, axis=-1))

    te = np.empty(len(field), dtype=np.complex128)
    tm = np.empty_like(te)
    slabs, kinds = plan.surface_slabs, dict[tuple[str, float], list[int]]()
    for index in np.unique(surface):
        kinds.setdefault((slabs[index].material, slabs[index].thickness_m), []).append(index)
    for (material, thickness_m), alike in kinds.items():
        mine = np.isin(surface, alike)
        specular = np.sqrt(1.0 - plan.scattering_of(material) ** 2)
        eta = plan.permittivity_of(material, carrier_hz)
        coefficients = slab_reflection(cosine[mine], eta, thickness_m, carrier_hz)
        te[mine], tm[mine] = (specular * coefficient for coefficient in coefficients)

    along_in, along_out = np.cross(across, incident), np.cross(across, outgoing)
    part_te = te * np.sum(field * across, axis=-1)
    part_tm = tm * np.sum(field * along_in, axis=-1)
    return np.asarray(part_te[:, None] * across + part_tm[:, None] * along_out)


def _any_other(normal: Array) -> Array:
    """For each unit vector one of the axes that is not parallel to it."""
    upright = np.abs(normal[:, 2:]) > 0.5
    return np.where(upright, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
