"""What an echo's receiver hears of its own transmitter, past all walls.

Transmitter and receiver of a device that hears its own echo are isolated by so many decibels; the
rest couples through the housing. Every beam couples differently and the same way in every sweep: a
circular Gaussian amplitude whose mean power over the beams is the isolation. The coupling has one
short delay. Oscillator phase noise reaches the receiver with it: a phase common to all tones of a
beam, and interference between tones of the same power, of which averaging over symbols leaves its share.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raytrace.plan.links import Echo

__all__ = ["leakage_response"]

Complex = NDArray[np.complex128]


def leakage_response(
    echo: Echo,
    isolation_db: float,
    sweeps: int,
    coupling_rng: np.random.Generator,
    phase_rng: np.random.Generator,
) -> Complex:
    """Leakage of every beam in some sweeps.

    Parameters
    ----------
    echo : Echo
        Beams, tones, delay and phase noise.
    isolation_db : float
        Transmitted over received power, mean over the beams, dB.
    sweeps : int
        How many.
    coupling_rng : Generator
        Draws the coupling of every beam: equal states give the same device.
    phase_rng : Generator
        Draws the phase noise.

    Returns
    -------
    ndarray of complex128, shape (sweeps, beams, tones)
        Received over transmitted amplitude, as the echo's response (dimensionless).
    """
    grid, beams = echo.grid(), echo.beams.beams
    coupling = _circular(coupling_rng, (beams, 1))
    coupling *= 10.0 ** (-isolation_db / 20.0) / np.sqrt(np.mean(np.abs(coupling) ** 2))
    frequency = grid.carrier_hz + grid.offsets_hz()
    steady = coupling * np.exp(-2j * np.pi * frequency * echo.leakage_delay_s)
    noise_rad = float(np.deg2rad(echo.leakage_phase_noise_deg))
    common = np.exp(1j * noise_rad * phase_rng.standard_normal((sweeps, beams, 1)))
    between = noise_rad / np.sqrt(grid.symbols) * _circular(phase_rng, (sweeps, beams, grid.tones))
    return np.asarray(steady * (common + between))


def _circular(rng: np.random.Generator, shape: tuple[int, ...]) -> Complex:
    """Circular complex Gaussian numbers of unit variance."""
    real, imaginary = rng.standard_normal((2, *shape))
    return np.asarray(np.sqrt(0.5) * (real + 1j * imaginary))
