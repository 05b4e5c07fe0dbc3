"""The leading edge: when the first path of an impulse response begins, whatever comes after it.

Where a pulse is followed by a dense tail, superresolution splits the two into pairs; the rising edge of the
first path is hardly touched by what comes later. The response is interpolated in band; the first sample above
a threshold is climbed to the top of its path, and the edge is where it passes a share of that top: ahead of
the path by the rise of the pulse, a constant of the device. Its deviation is that of a slope in noise.

References
----------
I. Guvenc, Z. Sahinoglu, "Threshold-based TOA estimation for impulse radio UWB systems", ICU 2005.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.errors import ConfigurationError, InputError

__all__ = ["LeadingEdge", "LeadingEdgeConfig", "leading_edges"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LeadingEdgeConfig:
    """How edges are found.

    Parameters
    ----------
    oversampling : int
        Samples interpolated for each tap.
    noise_factor : float
        The threshold is this many times the noise of a component, which noise passes once in 10^8 samples,
    peak_share : float
        and this share of the highest peak at least (20 dB): what leaks from it ahead in time is lower.
    edge_share : float
        Share of the first path's top at which its edge is taken: the steepest part of a pulse.
    window_taps : int
        The first path begins within so many taps of where it is sought.
    """

    oversampling: int = 16
    noise_factor: float = 6.0
    peak_share: float = 0.1
    edge_share: float = 0.5
    window_taps: int = 30

    def __post_init__(self) -> None:
        if self.oversampling < 1 or self.window_taps < 1 or not self.noise_factor > 0.0:
            raise ConfigurationError("LeadingEdgeConfig: expected positive numbers")
        if not (0.0 < self.peak_share < 1.0 and 0.0 < self.edge_share < 1.0):
            raise ConfigurationError("LeadingEdgeConfig: expected shares between 0 and 1")


@dataclass(frozen=True, eq=False)
class LeadingEdge:
    """First paths of N responses.

    Parameters
    ----------
    tap : ndarray, shape (N,)
        Where the edge is, taps from the first of the response; NaN where nothing rises from the noise.
    std_taps : ndarray, shape (N,)
        Standard deviation that the noise gives it.
    """

    tap: Array
    std_taps: Array


def leading_edges(
    cir: NDArray[np.complex128], near_tap: Array, config: LeadingEdgeConfig | None = None
) -> LeadingEdge:
    """Leading edges of impulse responses.

    Parameters
    ----------
    cir : ndarray of complex128, shape (N, taps)
        Impulse responses, evenly sampled, no slower than their band.
    near_tap : ndarray, shape (N,)
        Where the first path is sought, as the device tells it.
    config : LeadingEdgeConfig, optional
        How.

    Raises
    ------
    InputError
        If shapes do not fit.
    """
    config = config or LeadingEdgeConfig()
    cir, near = np.asarray(cir), np.asarray(near_tap, dtype=np.float64)
    if cir.ndim != 2 or near.shape != cir.shape[:1] or cir.shape[1] <= 2 * config.window_taps:
        raise InputError(
            "cir, near_tap: expected shapes (N, taps) and (N,) "
            f"with more than {2 * config.window_taps} taps, "
            f"got {cir.shape} and {near.shape}"
        )
    found = [_edge(row, float(tap), config) for row, tap in zip(cir, near, strict=True)]
    return LeadingEdge(np.array([tap for tap, _ in found]), np.array([std for _, std in found]))


def _edge(cir: NDArray[np.complex128], near: float, config: LeadingEdgeConfig) -> tuple[float, float]:
    """Tap and standard deviation of one response's edge."""
    fine, taps = config.oversampling, len(cir)
    spectrum = np.fft.fft(cir)
    half = taps // 2
    wide = np.zeros(taps * fine, dtype=np.complex128)
    wide[:half], wide[-half:] = spectrum[:half], spectrum[-half:]
    level = np.abs(np.fft.ifft(wide)) * fine
    begin = int(max(near - config.window_taps, 0) * fine)
    end = int(min(near + 2 * config.window_taps, taps) * fine)
    if end - begin < 2 * fine:
        return np.nan, np.nan
    enough = begin > config.window_taps * fine
    before = level[:begin] if enough else np.concatenate([level[:begin], level[end:]])
    noise = float(np.median(before)) / np.sqrt(2.0 * np.log(2.0))  # of a Rayleigh law's median, per component
    part = level[begin:end]
    threshold = max(config.noise_factor * noise, config.peak_share * float(part.max()))
    above = np.flatnonzero(part > threshold)
    if above.size == 0:
        return np.nan, np.nan
    top = int(above[0])
    while top + 1 < len(part) and part[top + 1] > part[top]:
        top += 1
    edge = config.edge_share * part[top]
    k = top
    while k > 0 and part[k] > edge:
        k -= 1
    slope = float(part[k + 1] - part[k])
    if slope <= 0.0:
        return np.nan, np.nan
    place = (begin + k + (edge - part[k]) / slope) / fine
    return float(place), noise / (slope * fine)
