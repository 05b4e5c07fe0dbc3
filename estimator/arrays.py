"""Antenna elements, uniform linear arrays and beam sets.

Directions are azimuths counter-clockwise from the x axis and elevations above the
horizontal plane, in radians. A uniform linear array (ULA) lies in the horizontal
plane, its axis 90 degrees counter-clockwise of its boresight, its phase centre in
the middle; element ``m`` of a wave *arriving from* (or leaving towards) azimuth
``az`` and elevation ``el`` has the phase ``+2 pi s (m - (M-1)/2) cos(el) sin(az - boresight)``
with ``s`` the spacing in wavelengths. A uniform planar array (UPA) has such rows one above the
other, the lowest first; row ``r`` adds ``+2 pi s_r (r - (R-1)/2) sin(el)``. Or it is *lying*: its
rows are one ahead of the other, and row ``r`` adds ``+2 pi s_r (r - (R-1)/2) cos(el) cos(az - boresight)``.

A ULA and an upright UPA do not tell front from back; a lying UPA tells all azimuths apart, and of an
elevation all but its sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError

__all__ = ["AntennaArray", "BeamSet", "UniformLinearArray", "UniformPlanarArray", "element_gain"]

_ELEMENT_WIDTH_RAD = np.deg2rad(65.0)
_ELEMENT_FLOOR_DB = 30.0
_ELEMENT_MAX_DBI = 8.0


def element_gain(offset_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.float64]:
    """Amplitude gain of a directive element (3GPP TR 38.901, Table 7.3-1).

    Parameters
    ----------
    offset_rad : array_like
        Azimuth relative to the element's boresight, radians, any branch.
    elevation_rad : array_like
        Elevation above the horizontal plane, radians; broadcasts with ``offset_rad``.

    Returns
    -------
    ndarray of float64
        Square root of the power gain; 8 dBi at boresight, -22 dBi behind.
    """
    offset = np.angle(np.exp(1j * np.asarray(offset_rad, dtype=np.float64)))
    horizontal = np.minimum(12.0 * (offset / _ELEMENT_WIDTH_RAD) ** 2, _ELEMENT_FLOOR_DB)
    vertical = np.minimum(
        12.0 * (np.asarray(elevation_rad, dtype=np.float64) / _ELEMENT_WIDTH_RAD) ** 2,
        _ELEMENT_FLOOR_DB,
    )
    gain_db = _ELEMENT_MAX_DBI - np.minimum(horizontal + vertical, _ELEMENT_FLOOR_DB)
    return np.asarray(10.0 ** (gain_db / 20.0))


@dataclass(frozen=True)
class UniformLinearArray:
    """A horizontal ULA of isotropic elements (an element of 1 is a single antenna).

    Parameters
    ----------
    elements : int
        Number of elements.
    spacing_wavelengths : float
        Distance between neighbours, wavelengths.
    boresight_rad : float
        Azimuth of the broadside direction, radians.
    """

    elements: int = 1
    spacing_wavelengths: float = 0.5
    boresight_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.elements < 1:
            raise ConfigurationError(f"elements: expected at least 1, got {self.elements}")
        if not 0.0 < self.spacing_wavelengths < np.inf:
            raise ConfigurationError(
                f"spacing_wavelengths: expected a positive number, got {self.spacing_wavelengths}"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of elements along each axis."""
        return (self.elements,)

    @property
    def spacings(self) -> tuple[float, ...]:
        """Distance between neighbours along each axis, wavelengths."""
        return (self.spacing_wavelengths,)

    @property
    def tells_azimuth(self) -> bool:
        """Whether each azimuth has a response of its own: no, front and back look alike."""
        return False

    def projection(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Components of the direction along the axes, shape ``broadcast(az, el).shape + (1,)``."""
        sine = np.sin(np.asarray(azimuth_rad, dtype=np.float64) - self.boresight_rad)
        return np.asarray((np.cos(elevation_rad) * sine)[..., None])

    def steering(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.complex128]:
        """Steering vectors (unit-modulus entries), shape ``broadcast(az, el).shape + (elements,)``."""
        index = np.arange(self.elements) - 0.5 * (self.elements - 1)
        projection = self.projection(azimuth_rad, elevation_rad)
        return np.asarray(np.exp(2j * np.pi * self.spacing_wavelengths * projection * index))


@dataclass(frozen=True)
class UniformPlanarArray:
    """A UPA of isotropic elements: rows of a horizontal ULA, one above or ahead of the other.

    Parameters
    ----------
    rows, columns : int
        Number of rows, and of elements in each.
    row_spacing_wavelengths, spacing_wavelengths : float
        Distance between neighbours in a column and in a row, wavelengths.
    boresight_rad : float
        Azimuth of the broadside direction of the rows, radians.
    lying : bool
        Whether the rows are one ahead of the other rather than one above the other.
    """

    rows: int = 1
    columns: int = 1
    row_spacing_wavelengths: float = 0.5
    spacing_wavelengths: float = 0.5
    boresight_rad: float = 0.0
    lying: bool = False

    def __post_init__(self) -> None:
        if self.rows < 1:
            raise ConfigurationError(f"rows: expected at least 1, got {self.rows}")
        if not 0.0 < self.row_spacing_wavelengths < np.inf:
            raise ConfigurationError(
                f"row_spacing_wavelengths: expected a positive number, got {self.row_spacing_wavelengths}"
            )
        self._row()

    def _row(self) -> UniformLinearArray:
        return UniformLinearArray(self.columns, self.spacing_wavelengths, self.boresight_rad)

    @property
    def elements(self) -> int:
        """Elements of all rows."""
        return self.rows * self.columns

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of elements along each axis: (rows, columns)."""
        return (self.rows, self.columns)

    @property
    def spacings(self) -> tuple[float, ...]:
        """Distance between neighbours along each axis, wavelengths."""
        return (self.row_spacing_wavelengths, self.spacing_wavelengths)

    @property
    def tells_azimuth(self) -> bool:
        """Whether each azimuth has a response of its own."""
        return self.lying and min(self.shape) > 1 and max(self.spacings) <= 0.5

    def projection(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Components of the direction from row to row and along the rows, shape ``(..., 2)``."""
        along = self._row().projection(azimuth_rad, elevation_rad)[..., 0]
        offset = np.asarray(azimuth_rad, dtype=np.float64) - self.boresight_rad
        rise = np.sin(np.asarray(elevation_rad, dtype=np.float64))
        across = np.cos(elevation_rad) * np.cos(offset) if self.lying else np.broadcast_to(rise, along.shape)
        return np.stack([across, along], axis=-1)

    def steering(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.complex128]:
        """Steering vectors, row by row from the first, shape ``broadcast(az, el).shape + (elements,)``."""
        row = self._row().steering(azimuth_rad, elevation_rad)
        number = np.arange(self.rows) - 0.5 * (self.rows - 1)
        across = self.projection(azimuth_rad, elevation_rad)[..., :1]
        column = np.exp(2j * np.pi * self.row_spacing_wavelengths * across * number)
        whole = column[..., :, None] * row[..., None, :]
        return np.asarray(whole.reshape(*row.shape[:-1], self.elements))


AntennaArray = UniformLinearArray | UniformPlanarArray


@dataclass(frozen=True)
class BeamSet:
    """Beams of several identical ULA panels that together look all around.

    Panel ``p`` has boresight ``heading + 2 pi p / panels``; its beams are uniform in
    the sine of the angle from boresight and fill the panel's sector. Transmit and
    receive use the same beam (the paper's (5)), with unit-norm weights, so that a
    beam's two-way amplitude gain at its centre is ``elements * element_gain^2``.

    Parameters
    ----------
    panels, elements, beams : int
        Panels, elements of each, and beams of all panels together.
    spacing_wavelengths : float
        Element spacing, wavelengths.
    heading_rad : float
        Boresight of panel 0, radians.
    """

    panels: int = 4
    elements: int = 16
    beams: int = 64
    spacing_wavelengths: float = 0.5
    heading_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("panels", "elements", "beams"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if self.beams % self.panels:
            raise ConfigurationError(
                f"beams: expected a multiple of panels ({self.panels}), got {self.beams}"
            )
        if not 0.0 < self.spacing_wavelengths < np.inf:
            raise ConfigurationError(
                f"spacing_wavelengths: expected a positive number, got {self.spacing_wavelengths}"
            )

    @property
    def beams_per_panel(self) -> int:
        """Beams of one panel."""
        return self.beams // self.panels

    def panel_boresights(self) -> NDArray[np.float64]:
        """Boresight azimuth of every panel, shape (panels,), radians."""
        return self.heading_rad + 2.0 * np.pi * np.arange(self.panels) / self.panels

    def beam_offsets(self) -> NDArray[np.float64]:
        """Beam directions relative to boresight, shape (beams_per_panel,), radians."""
        edge = np.sin(min(np.pi / self.panels, 0.5 * np.pi))
        count = self.beams_per_panel
        return np.asarray(np.arcsin(edge * (2.0 * np.arange(count) + 1.0 - count) / count))

    def azimuths(self) -> NDArray[np.float64]:
        """Azimuth of every beam, panel by panel, shape (beams,), radians."""
        return (self.panel_boresights()[:, None] + self.beam_offsets()[None, :]).ravel()

    def one_way(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.complex128]:
        """One-way complex amplitude of every beam, shape ``broadcast(az, el).shape + (beams,)``."""
        azimuth, elevation = np.broadcast_arrays(
            np.asarray(azimuth_rad, dtype=np.float64), np.asarray(elevation_rad, dtype=np.float64)
        )
        offset = azimuth[..., None] - self.panel_boresights()  # (..., panels)
        array = UniformLinearArray(self.elements, self.spacing_wavelengths)
        weights = array.steering(self.beam_offsets()) / np.sqrt(self.elements)  # (b, m)
        steering = array.steering(offset, elevation[..., None])  # (..., panels, m)
        gain = element_gain(offset, elevation[..., None])[..., None]
        response = gain * (steering @ weights.conj().T)
        return np.asarray(response.reshape(*azimuth.shape, self.beams))

    def two_way(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike = 0.0) -> NDArray[np.complex128]:
        """Two-way amplitude of a return that leaves and arrives in one direction; as :meth:`one_way`."""
        return np.asarray(self.one_way(azimuth_rad, elevation_rad) ** 2)
