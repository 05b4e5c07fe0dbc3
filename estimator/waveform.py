"""OFDM grids, noise power and free-space loss.

A :class:`OfdmGrid` describes the tones that carry pilots. Channel frequency
responses (CFR) in this project are *channel gains*: dimensionless complex numbers
``H`` with ``|H|^2`` the received over the transmitted (EIRP) power, so that

    H(f) = sum_m a_m exp(-j 2 pi f tau_m),   f the tone's offset from the carrier,

where ``a_m`` contains the carrier phase ``exp(-j 2 pi f_c tau_m)``. An estimate of
``H`` carries circular complex Gaussian noise of variance
:meth:`OfdmGrid.noise_variance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.errors import ConfigurationError

__all__ = [
    "BOLTZMANN_J_PER_K",
    "NOISE_TEMPERATURE_K",
    "SPEED_OF_LIGHT_M_S",
    "OfdmGrid",
    "free_space_loss_db",
    "frequency_response",
    "impulse_response",
]

SPEED_OF_LIGHT_M_S = 299_792_458.0
BOLTZMANN_J_PER_K = 1.380_649e-23
NOISE_TEMPERATURE_K = 290.0


def free_space_loss_db(distance_m: NDArray[np.float64], carrier_hz: ArrayLike) -> NDArray[np.float64]:
    """Free-space path loss between isotropic antennas, in dB (positive).

    Parameters
    ----------
    distance_m : array
        Path length in metres, any shape, positive.
    carrier_hz : array_like
        Carrier frequency in hertz, of all lengths or one of each.
    """
    cycles = np.asarray(distance_m) * np.asarray(carrier_hz) / SPEED_OF_LIGHT_M_S
    return np.asarray(20.0 * np.log10(4.0 * np.pi * cycles))


@dataclass(frozen=True)
class OfdmGrid:
    """The pilot tones of one OFDM symbol.

    Parameters
    ----------
    carrier_hz : float
        Carrier frequency, hertz.
    subcarrier_spacing_hz : float
        Spacing of neighbouring subcarriers, hertz.
    subcarriers : int
        Subcarriers the signal spans (with comb 4, a quarter of them are tones).
    comb : int
        Every ``comb``-th subcarrier carries a pilot.
    symbols : int
        OFDM symbols averaged coherently into one CFR.
    """

    carrier_hz: float
    subcarrier_spacing_hz: float
    subcarriers: int
    comb: int = 1
    symbols: int = 1

    def __post_init__(self) -> None:
        for name in ("carrier_hz", "subcarrier_spacing_hz", "subcarriers", "comb", "symbols"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise ConfigurationError(f"OfdmGrid.{name}: expected a positive number, got {value!r}")
        if self.subcarriers < 2 * self.comb:
            raise ConfigurationError(
                f"OfdmGrid.subcarriers: expected at least two tones ({2 * self.comb} subcarriers "
                f"at comb {self.comb}), got {self.subcarriers}"
            )

    @property
    def tones(self) -> int:
        """Number of pilot tones."""
        return self.subcarriers // self.comb

    @property
    def tone_spacing_hz(self) -> float:
        """Spacing of pilot tones, hertz; delays are unambiguous up to its inverse."""
        return self.subcarrier_spacing_hz * self.comb

    @property
    def bandwidth_hz(self) -> float:
        """Span of the tones, ``tones * tone_spacing_hz``, hertz."""
        return self.tones * self.tone_spacing_hz

    @property
    def resolution_s(self) -> float:
        """Delay resolution, the inverse of the bandwidth, seconds."""
        return 1.0 / self.bandwidth_hz

    @property
    def unambiguous_s(self) -> float:
        """Longest delay without aliasing, seconds."""
        return 1.0 / self.tone_spacing_hz

    @property
    def wavelength_m(self) -> float:
        """Carrier wavelength, metres."""
        return SPEED_OF_LIGHT_M_S / self.carrier_hz

    def offsets_hz(self) -> NDArray[np.float64]:
        """Tone offsets from the carrier, ascending, centred on zero, shape (tones,), hertz."""
        index = np.arange(self.tones, dtype=np.float64) - 0.5 * (self.tones - 1)
        return index * self.tone_spacing_hz

    def taps_s(self) -> NDArray[np.float64]:
        """Delays of the taps of an impulse response, one resolution apart, shape (tones,), seconds."""
        return np.arange(self.tones, dtype=np.float64) * self.resolution_s

    def noise_variance(self, power_dbm: float, noise_figure_db: float) -> float:
        """Variance of the noise on one tone of a CFR estimate (dimensionless).

        The transmit power is shared by the tones; thermal noise
        ``k T F`` fills one subcarrier; ``symbols`` are averaged.

        Parameters
        ----------
        power_dbm : float
            Transmit power (EIRP for passive links), dBm, over all tones.
        noise_figure_db : float
            Receiver noise figure, dB.
        """
        power_per_tone_w = 10.0 ** (power_dbm / 10.0 - 3.0) / self.tones
        noise_w = (
            BOLTZMANN_J_PER_K
            * NOISE_TEMPERATURE_K
            * self.subcarrier_spacing_hz
            * 10.0 ** (noise_figure_db / 10.0)
        )
        return float(noise_w / (power_per_tone_w * self.symbols))


def impulse_response(cfr: NDArray[np.complex128], grid: OfdmGrid) -> NDArray[np.complex128]:
    """Channel impulse response of a CFR, by the inverse DFT over the tones.

        h_n = 1/N sum_k H(f_k) exp(+j 2 pi f_k t_n),   t_n = n / bandwidth

    A path between taps leaks into its neighbours (no window is applied), so that
    :func:`frequency_response` restores the CFR; the noise on a tap has the variance
    of that on a tone over the number of tones.

    Parameters
    ----------
    cfr : ndarray of complex128, shape (..., tones)
        Channel gains on the grid's tones (dimensionless).
    grid : OfdmGrid
        The tones.

    Returns
    -------
    ndarray of complex128, shape (..., tones)
        Taps at :meth:`OfdmGrid.taps_s`.
    """
    turn = np.exp(2j * np.pi * grid.offsets_hz()[0] * grid.taps_s())
    return np.asarray(turn * np.fft.ifft(cfr, axis=-1))


def frequency_response(cir: NDArray[np.complex128], grid: OfdmGrid) -> NDArray[np.complex128]:
    """CFR of an impulse response: the inverse of :func:`impulse_response`, same shapes."""
    turn = np.exp(-2j * np.pi * grid.offsets_hz()[0] * grid.taps_s())
    return np.asarray(np.fft.fft(turn * cir, axis=-1))
