"""The two radio links of a plan: anchors to agent (passive) and agent to itself (echo)."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from estimator.arrays import BeamSet, UniformLinearArray, UniformPlanarArray
from estimator.waveform import OfdmGrid

__all__ = [
    "AgentArray",
    "AnchorArray",
    "Beams",
    "Count",
    "Echo",
    "Finite",
    "NonNegative",
    "Part",
    "Positive",
    "Radio",
    "added",
]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1)]


class Part(BaseModel):
    """Base of all parts of a plan: frozen, strict, and without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def added(default: Any) -> Any:
    """A field that came later: a plan that leaves it at its default is written, and hashed, without it."""
    return Field(default=default, exclude_if=lambda value: value == default)


class AnchorArray(Part):
    """The array of every anchor: ``rows`` one above the other of ``elements`` side by side.

    ``pattern`` and ``polarization`` of the elements are named as in Sionna RT; see
    :mod:`raytrace.radio.antennas`. Every element sends pilots of its own, each with the link's EIRP,
    to which the pattern's gain comes on top.
    """

    elements: Count = 1
    spacing_wavelengths: Positive = 0.5
    rows: Count = added(1)
    row_spacing_wavelengths: Positive = added(0.5)
    pattern: Literal["iso", "dipole", "hw_dipole", "tr38901"] = added("iso")
    polarization: Literal["V", "H"] = added("V")

    @property
    def antennas(self) -> int:
        """Number of elements in all rows."""
        return self.rows * self.elements

    def facing(self, boresight_rad: float) -> UniformLinearArray | UniformPlanarArray:
        """The array with its broadside towards an azimuth of its frame, radians."""
        if self.rows == 1:
            return UniformLinearArray(self.elements, self.spacing_wavelengths, boresight_rad)
        return UniformPlanarArray(
            self.rows, self.elements, self.row_spacing_wavelengths, self.spacing_wavelengths, boresight_rad
        )


class AgentArray(AnchorArray):
    """The agent's receiving array relative to its heading; fields as those of anchors.

    It is upright, or ``lying``: the rows one ahead of the other, which tells all azimuths apart.
    """

    boresight_deg: Finite = 0.0
    lying: bool = added(False)

    @property
    def boresight_rad(self) -> float:
        """Azimuth of its broadside in the agent's frame, radians."""
        return float(np.deg2rad(self.boresight_deg))

    def array(self) -> UniformLinearArray | UniformPlanarArray:
        """The array in the agent's frame."""
        array = self.facing(self.boresight_rad)
        if isinstance(array, UniformPlanarArray):
            return replace(array, lying=self.lying)
        return array


class _Signal(Part):
    carrier_hz: Positive = 28e9
    subcarrier_spacing_hz: Positive = 120e3
    subcarriers: Count = 3276
    comb: Count = 4
    noise_figure_db: NonNegative = 7.0
    symbols: Count = 12

    def grid(self) -> OfdmGrid:
        """The pilot tones."""
        return OfdmGrid(
            self.carrier_hz, self.subcarrier_spacing_hz, self.subcarriers, self.comb, self.symbols
        )

    @model_validator(mode="after")
    def _has_tones(self) -> _Signal:
        if self.subcarriers < 2 * self.comb:
            raise ValueError(f"expected subcarriers >= 2 * comb = {2 * self.comb}, got {self.subcarriers}")
        return self


class Radio(_Signal):
    """The passive link: every anchor sends pilots, the agent receives.

    ``timing_jitter_s`` is the standard deviation of the timing error of each CFR. An epoch
    has ``snapshots`` CFRs, ``snapshot_interval_s`` apart, between which every path turns by its
    Doppler shift; each integrates ``symbols`` symbols.
    """

    eirp_dbm: Finite = 26.0
    timing_jitter_s: NonNegative = 0.0
    agent_array: AgentArray = AgentArray()
    anchor_array: AnchorArray = added(AnchorArray())
    snapshots: Count = added(1)
    snapshot_interval_s: Positive = added(1e-3)

    def noise_variance(self) -> float:
        """Noise variance on one tone of a CFR estimate (dimensionless)."""
        return self.grid().noise_variance(self.eirp_dbm, self.noise_figure_db)


class Beams(Part):
    """The agent's beams, relative to its heading; see :class:`estimator.arrays.BeamSet`."""

    panels: Count = 4
    elements: Count = 16
    beams: Count = 64
    spacing_wavelengths: Positive = 0.5
    heading_deg: Finite = 0.0

    @model_validator(mode="after")
    def _divides(self) -> Beams:
        if self.beams % self.panels:
            raise ValueError(f"expected beams to be a multiple of panels = {self.panels}, got {self.beams}")
        return self

    def beam_set(self) -> BeamSet:
        """The beams in the agent's frame."""
        return BeamSet(
            self.panels,
            self.elements,
            self.beams,
            self.spacing_wavelengths,
            float(np.deg2rad(self.heading_deg)),
        )


class Echo(_Signal):
    """The active link: the agent sweeps its beams and listens to its own echo.

    ``physical`` traces specular returns to ``depth`` bounces and, off materials that
    scatter, diffuse ones from ``diffuse_samples`` rays; ``radar-equation`` is the
    paper's (7) on traced hits, with radar cross section ``gamma cos^(2 eta)`` of the
    angle of incidence, on ``fan_rays`` rays all around (0: pencil beams, as the paper).
    ``gain_error_db`` and ``phase_error_deg`` are the standard deviations of each beam's
    two-way calibration error, ``range_error_m`` that of the front end's delay.

    The beams sweep at ``sweep_epochs`` or, with ``sweep_every = K``, at epochs 0, K, 2 K, ... One beam
    follows the other after ``beam_interval_s``, in which returns turn by their Doppler shifts. With
    ``isolation_db`` the transmitter leaks into the receiver, ``leakage_delay_s`` later and with
    ``leakage_phase_noise_deg``: see :mod:`raytrace.radio.leakage`.
    """

    symbols: Count = 14
    model: Literal["physical", "radar-equation"] = "physical"
    tx_power_dbm: Finite = 10.0
    depth: Annotated[int, Field(ge=1, le=3)] = 2
    separation_m: Annotated[float, Field(gt=0.0, le=0.5)] = 0.05
    gamma: Positive = 1.0
    eta: NonNegative = 0.2
    fan_rays: Annotated[int, Field(ge=0, le=100_000)] = 1440
    diffuse_samples: Annotated[int, Field(ge=100, le=1_000_000)] = 20_000
    gain_error_db: NonNegative = 0.0
    phase_error_deg: NonNegative = 0.0
    range_error_m: NonNegative = 0.0
    beams: Beams = Beams()
    sweep_epochs: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1, strict=False)] = (0,)
    sweep_every: Count | None = added(None)
    beam_interval_s: Annotated[float, Field(ge=0.0, le=1.0)] = added(0.0)
    isolation_db: Finite | None = added(None)
    leakage_delay_s: NonNegative = added(0.5e-9)
    leakage_phase_noise_deg: Annotated[float, Field(ge=0.0, le=30.0)] = added(1.0)

    @model_validator(mode="after")
    def _sweeps_one_way(self) -> Echo:
        if self.sweep_every is not None and self.sweep_epochs != (0,):
            raise ValueError(f"expected sweep_epochs or sweep_every, got both ({self.sweep_every})")
        return self

    def noise_variance(self) -> float:
        """Noise variance on one tone of one beam's response (dimensionless)."""
        return self.grid().noise_variance(self.tx_power_dbm, self.noise_figure_db)
