"""Ranges of echoes: the signal of one reflection, its power law, and how well its range can be known.

A reflecting-surface point (RSP) at the distance ``d`` returns, on tone ``n = 1 .. N``,

    Gamma_n(d) = b / d^2 exp(-j 2 pi (n - N/2) df 2 d / c),  |b|^2 = lambda^2 e / (4 pi)^3,    (7)

with the cross section ``e = gamma cos^(2 eta)(psi)`` at the incidence ``psi``. Three bounds on the
variance of ``d`` differ in what else is taken for known:

=================================  ==========================  =======================================
the complex gain ``b / d^2`` is    bound                       what the range is read from
=================================  ==========================  =======================================
known but for ``d``, (15)          :func:`variance_exact`      phase slope, phase *and* amplitude
unknown, for many tones, (16)      :func:`variance_published`  phase slope
unknown, for any number of tones   :func:`variance_honest`     phase slope
=================================  ==========================  =======================================

The published derivation drops the amplitude's term of (15) as ``O(1/N)``. It is
``3 c^2 / (pi^2 d^2 B^2)`` of the rest, which no number of tones makes small at a fixed bandwidth
(47 % at 10 m and 24 MHz); but as the cross section is never known, the term is not there to be
used, and (16) is the right bound all the same.

Equation numbers refer to:

    J. Yang, C.-K. Wen, S. Jin, "Hybrid Active and Passive Sensing for SLAM in
    Wireless Communication Systems".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.arrays import BeamSet
from estimator.channel.bounds import range_variance
from estimator.errors import ConfigurationError, InputError
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

__all__ = [
    "EchoLaw",
    "echo_response",
    "sweep_response",
    "variance_exact",
    "variance_honest",
    "variance_published",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def _positive(name: str, value: ArrayLike) -> Real:
    array = np.asarray(value, dtype=np.float64)
    if not np.all((array > 0.0) & (array < np.inf)):
        raise InputError(
            f"{name}: expected positive numbers, got {array[~((array > 0) & (array < np.inf))][0]}"
        )
    return array


@dataclass(frozen=True)
class EchoLaw:
    """How the signal-to-noise ratio of one tone falls with distance and incidence.

    Parameters
    ----------
    snr : float
        Ratio at ``reference_m`` and normal incidence, linear, positive.
    reference_m : float
        Distance at which ``snr`` holds, metres.
    exponent : float
        Power falls as ``d^-exponent``: 4 for a point that scatters, as in (7); 2 for a wall that
        mirrors, which is the law that the paper's numbers in Section V-E follow.
    eta : float
        Half the exponent of the cross section's cosine.
    """

    snr: float = 1.0
    reference_m: float = 10.0
    exponent: float = 4.0
    eta: float = 0.2

    def __post_init__(self) -> None:
        for name in ("snr", "reference_m", "exponent"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"EchoLaw.{name}: expected a positive number, got {getattr(self, name)}"
                )
        if not 0.0 <= self.eta < np.inf:
            raise ConfigurationError(f"EchoLaw.eta: expected 0 or more, got {self.eta}")

    @classmethod
    def of_radar(
        cls, wavelength_m: float, noise_variance: float, gamma: float = 1.0, eta: float = 0.2
    ) -> EchoLaw:
        """The radar equation's law, ``lambda^2 e / ((4 pi)^3 d^4 sigma^2)`` (Theorem 1).

        Parameters
        ----------
        wavelength_m : float
            Wavelength, metres.
        noise_variance : float
            Variance of the noise on a tone, relative to the transmitted power of the tone.
        gamma, eta : float
            Cross section at normal incidence, square metres, and its exponent.
        """
        for name, value in (
            ("wavelength_m", wavelength_m),
            ("noise_variance", noise_variance),
            ("gamma", gamma),
        ):
            if not 0.0 < value < np.inf:
                raise ConfigurationError(f"{name}: expected a positive number, got {value}")
        snr = wavelength_m**2 * gamma / ((4.0 * np.pi) ** 3 * noise_variance)
        return cls(snr, 1.0, 4.0, eta)

    def at(self, distance_m: ArrayLike, incidence_rad: ArrayLike = 0.0) -> Real:
        """Signal-to-noise ratio of one tone, linear, in the broadcast shape of the arguments.

        Parameters
        ----------
        distance_m : array_like
            Distances, metres, positive.
        incidence_rad : array_like
            Angles between ray and wall normal, radians; 0 from pi / 2 on.
        """
        distance = _positive("distance_m", distance_m)
        cosine = np.maximum(np.cos(np.asarray(incidence_rad, dtype=np.float64)), 0.0)
        return np.asarray(
            self.snr * (distance / self.reference_m) ** -self.exponent * cosine ** (2.0 * self.eta)
        )


def echo_response(grid: OfdmGrid, distance_m: ArrayLike, amplitude: ArrayLike = 1.0) -> Complex:
    """Noiseless responses of reflections, (7) and (13).

    Parameters
    ----------
    grid : OfdmGrid
        The tones; ``N`` of them, ``df`` apart.
    distance_m : array_like, shape (...)
        Distances of the RSPs, metres.
    amplitude : array_like of complex
        ``b / d^2``, broadcasts with ``distance_m``.

    Returns
    -------
    ndarray of complex128, shape (..., tones)
    """
    distance, gain = np.broadcast_arrays(
        np.asarray(distance_m, np.float64), np.asarray(amplitude, np.complex128)
    )
    frequency = (np.arange(1, grid.tones + 1) - 0.5 * grid.tones) * grid.tone_spacing_hz
    delay = 2.0 * distance[..., None] / SPEED_OF_LIGHT_M_S
    return np.asarray(gain[..., None] * np.exp(-2j * np.pi * frequency * delay))


def sweep_response(
    grid: OfdmGrid, beams: BeamSet, azimuth_rad: ArrayLike, distance_m: ArrayLike, amplitude: ArrayLike
) -> Complex:
    """Noiseless responses of all beams, each sending and receiving in its own direction, (5) and (6).

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    beams : BeamSet
        The beams.
    azimuth_rad, distance_m, amplitude : array_like, shape (M,)
        Direction (radians), distance (metres) and amplitude ``b / d^2`` of every RSP.

    Returns
    -------
    ndarray of complex128, shape (beams, tones)
    """
    echoes = echo_response(grid, np.atleast_1d(np.asarray(distance_m, np.float64)), amplitude)
    return np.asarray(beams.two_way(np.atleast_1d(np.asarray(azimuth_rad, np.float64))).T @ echoes)


def variance_exact(grid: OfdmGrid, distance_m: ArrayLike, snr: ArrayLike, exponent: float = 4.0) -> Real:
    """Bound on a range's variance if the gain is known but for the distance: (15), by (49)-(54).

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    distance_m : array_like
        Distances, metres.
    snr : array_like
        Signal-to-noise ratio of one tone at that distance, linear.
    exponent : float
        The amplitude is taken to fall as ``d^(-exponent / 2)``.

    Returns
    -------
    ndarray of float64
        Square metres, in the broadcast shape of ``distance_m`` and ``snr``.
    """
    distance, ratio = _positive("distance_m", distance_m), _positive("snr", snr)
    tones = float(grid.tones)
    slope = 4.0 * np.pi * grid.tone_spacing_hz / SPEED_OF_LIGHT_M_S
    phase = slope**2 * (tones**3 + 2.0 * tones) / 12.0  # sum over (n - N/2)^2, below (52)
    amplitude = tones * (0.5 * exponent / distance) ** 2
    return np.asarray(1.0 / (2.0 * ratio * (phase + amplitude)))


def variance_published(grid: OfdmGrid, snr: ArrayLike) -> Real:
    """Bound on a range's variance by Theorem 1, (16): ``3 c^2 / (8 pi^2 B^2 N snr)``, square metres.

    Parameters
    ----------
    grid : OfdmGrid
        The tones.
    snr : array_like
        Signal-to-noise ratio of one tone, linear.
    """
    scale = 3.0 * SPEED_OF_LIGHT_M_S**2 / (8.0 * np.pi**2 * grid.bandwidth_hz**2 * grid.tones)
    return np.asarray(scale / _positive("snr", snr))


def variance_honest(grid: OfdmGrid, snr: ArrayLike) -> Real:
    """Bound on a range's variance if the complex gain is unknown: (16) over ``1 - 1 / N^2``, square metres.

    Arguments as of :func:`variance_published`.
    """
    return range_variance(grid, _positive("snr", snr), two_way=True)
