"""Antenna elements: pattern, polarisation and how they are mounted.

The field of an element in a direction has two parts, along the unit vectors of spherical
coordinates (zenith, azimuth). In the element's own frame, x towards its boresight and z up,

    (C_zenith, C_azimuth) = C(zenith, azimuth) (cos slant, sin slant),

with a slant of 0 for ``V`` and of 90 degrees for ``H`` (the second model of 3GPP TR 38.901,
7.3.2) and the patterns ``C`` of Sionna RT: ``iso``; ``dipole``, 1.76 dBi; ``hw_dipole``, half a
wavelength, 2.16 dBi; ``tr38901``, 8 dBi and 65 degrees wide. A mounted element is turned about z
to its azimuth and then tilted down; its field is turned with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.arrays import element_gain
from raytrace.propagation.directions import angles_of, spherical_basis

__all__ = ["Element", "Pattern", "Polarization", "mounted"]

Array = NDArray[np.float64]
Pattern = Literal["iso", "dipole", "hw_dipole", "tr38901"]
Polarization = Literal["V", "H"]

_SLANT_RAD = {"V": 0.0, "H": 0.5 * np.pi}


@dataclass(frozen=True)
class Element:
    """An antenna element.

    Parameters
    ----------
    pattern : {"iso", "dipole", "hw_dipole", "tr38901"}
        Its directivity.
    polarization : {"V", "H"}
        Its polarisation.
    """

    pattern: Pattern = "iso"
    polarization: Polarization = "V"

    def field(self, directions: Array, mount: Array) -> Array:
        """Amplitude gains of the two parts of the field.

        Parameters
        ----------
        directions : ndarray, shape (..., 3)
            Unit vectors away from the antenna, plan frame.
        mount : ndarray, shape (..., 3, 3)
            Its axes in the plan, as columns; see :func:`mounted`.

        Returns
        -------
        ndarray of float64, shape (..., 2)
            Along the zenith and azimuth unit vectors of the plan frame (dimensionless).
        """
        own = np.einsum("...ji,...j->...i", mount, directions)
        slant = _SLANT_RAD[self.polarization]
        parts = self._gain(own)[..., None] * np.array([np.cos(slant), np.sin(slant)])
        vector = np.einsum("...ij,...pj,...p->...i", mount, spherical_basis(own), parts)
        return np.asarray(np.einsum("...pi,...i->...p", spherical_basis(directions), vector))

    def _gain(self, own: Array) -> Array:
        azimuth, elevation = angles_of(own)
        level = np.cos(elevation)
        if self.pattern == "tr38901":
            return element_gain(azimuth, elevation)
        if self.pattern == "dipole":
            return np.asarray(np.sqrt(1.5) * level)
        if self.pattern == "hw_dipole":
            along = np.cos(0.5 * np.pi * np.sin(elevation))
            along = np.divide(along, level, out=np.zeros_like(level), where=level > 1e-5)
            return np.asarray(np.sqrt(1.643) * along)
        return np.ones_like(level)


def mounted(azimuth_rad: ArrayLike, downtilt_rad: ArrayLike = 0.0) -> Array:
    """Axes of antennas that look towards an azimuth and down, shape ``broadcast + (3, 3)``, as columns."""
    azimuth, tilt = np.broadcast_arrays(np.asarray(azimuth_rad), np.asarray(downtilt_rad))
    c, s, ct, st = np.cos(azimuth), np.sin(azimuth), np.cos(tilt), np.sin(tilt)
    rows = [[c * ct, -s, c * st], [s * ct, c, s * st], [-st, np.zeros_like(c), ct]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
