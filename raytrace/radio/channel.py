"""From paths to channel frequency responses on an OFDM grid, and thermal noise.

    H(f) = sum_m a_m s_m exp(-j 2 pi f tau_m),

``f`` the tone's offset from the carrier, ``a_m`` the amplitude with its carrier
phase, ``s_m`` what antennas and motion make of it (:mod:`raytrace.radio.reception`). Delays
are absolute: nothing is shifted to make the first path arrive at zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimator.waveform import OfdmGrid
from raytrace.propagation.paths import PathSet

__all__ = ["add_noise", "channel_response", "superpose"]

# Largest product of matrices, rows x columns x paths, that is formed at a time. OpenBLAS gives
# larger ones (65536) to several threads, which on matrices this small wait for each other longer
# than they work, and the last bits of the sum would depend on the number of cores.
_PRODUCT = 60_000


def superpose(
    weights: NDArray[np.complex128], delay_s: NDArray[np.float64], grid: OfdmGrid
) -> NDArray[np.complex128]:
    """Sum weighted delays on the tones of a grid.

    A tone's index is ``q i + j``; its phase is a product of a factor for ``i`` and one
    for ``j``. So the sum over paths is a product of two small matrices, about
    ``tones / (2 sqrt(tones))`` times cheaper in exponentials than tone by tone.

    Parameters
    ----------
    weights : ndarray of complex128, shape (..., signals, paths)
        What each path adds to each signal (antenna or beam), at the carrier.
    delay_s : ndarray of float64, shape (..., paths)
        Delays, seconds; leading axes as those of ``weights``.
    grid : OfdmGrid
        The tones.

    Returns
    -------
    ndarray of complex128, shape (..., signals, tones)
    """
    fine_count = int(np.ceil(np.sqrt(grid.tones)))
    coarse_count = -(-grid.tones // fine_count)
    turn = -2j * np.pi * np.asarray(delay_s, dtype=np.float64)[..., None, :]  # (..., 1, paths)
    total = np.zeros((*weights.shape[:-1], coarse_count, fine_count), dtype=np.complex128)
    block = max(1, _PRODUCT // (coarse_count * fine_count))
    for start in range(0, weights.shape[-1], block):
        part = slice(start, start + block)
        first = weights[..., part] * np.exp(turn[..., part] * grid.offsets_hz()[0])
        coarse = _powers(np.exp(turn[..., part] * fine_count * grid.tone_spacing_hz), coarse_count)
        fine = _powers(np.exp(turn[..., part] * grid.tone_spacing_hz), fine_count)
        weighted = first[..., None] * coarse  # (..., signals, paths, coarse)
        total += np.swapaxes(weighted, -1, -2) @ fine  # (..., signals, coarse, fine)
    return total.reshape(*weights.shape[:-1], -1)[..., : grid.tones]


def _powers(base: NDArray[np.complex128], count: int) -> NDArray[np.complex128]:
    """Powers 0 to ``count - 1`` of numbers on the unit circle, along a new last axis."""
    steps = np.repeat(base[..., None], count, axis=-1)
    steps[..., 0] = 1.0
    return np.asarray(np.cumprod(steps, axis=-1))


def channel_response(
    paths: PathSet, grid: OfdmGrid, signals: NDArray[np.complex128] | None = None
) -> NDArray[np.complex128]:
    """Noiseless channel of every link.

    Parameters
    ----------
    paths : PathSet
        Axes (epoch, anchor, path), angles in the plan frame.
    grid : OfdmGrid
        The tones.
    signals : ndarray of complex128, shape (epochs, anchors, signals, path), optional
        What each path's amplitude is multiplied with in each signal (antenna, snapshot);
        by default one signal gets the paths as they are.

    Returns
    -------
    ndarray of complex128, shape (epochs, anchors, signals, tones)
        Channel gains (dimensionless).
    """
    amplitude = np.where(paths.valid, paths.amplitude, 0.0)[..., None, :]
    weights = amplitude if signals is None else signals * amplitude
    return superpose(weights, np.where(paths.valid, paths.delay_s, 0.0), grid)


def add_noise(response: ArrayLike, variance: float, rng: np.random.Generator) -> NDArray[np.complex128]:
    """A response plus circular complex Gaussian noise of a variance per entry, same shape."""
    clean = np.asarray(response, dtype=np.complex128)
    noise = rng.standard_normal((*clean.shape, 2)) * np.sqrt(0.5 * variance)
    return np.asarray(clean + noise[..., 0] + 1j * noise[..., 1])
