"""The strongest atom in a residual: an oversampled grid over delays and directions, by FFT."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

__all__ = ["PeakSearch"]

_ARRAY_OVERSAMPLING = 2  # points per resolution cell of an array's axis


class PeakSearch:
    """Finds the grid point with the largest correlation energy.

    Parameters
    ----------
    tones : int
        Number of tones.
    array_shape : tuple of int
        Elements along each axis of the array; empty for a single antenna.
    spacings : tuple of float
        Distance of neighbours along each axis, wavelengths: no wave has more turns from one to the next.
    oversampling : int
        Points per resolution cell in delay.
    """

    def __init__(
        self, tones: int, array_shape: tuple[int, ...], spacings: tuple[float, ...], oversampling: int
    ) -> None:
        self._bins = scipy.fft.next_fast_len(oversampling * tones)
        self._turns = _visible(array_shape, spacings)
        places = np.indices(array_shape).reshape(len(array_shape), int(np.prod(array_shape)))
        # The phase of the array's corner instead of its centre is common to all elements.
        self._weights = np.exp(2j * np.pi * self._turns @ places)  # (directions, antennas)

    def find(self, residual: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Points of the strongest atoms of residuals (C, S, antennas, tones), shape (C, D), in turns."""
        if residual.shape[2] == 1:
            spectrum = scipy.fft.ifft(residual[:, :, 0], self._bins, axis=2)
            energy = np.sum(spectrum.real**2 + spectrum.imag**2, axis=1)
            return np.asarray(np.argmax(energy, axis=1)[:, None] / self._bins)
        return np.array([self._of(channel) for channel in residual]).reshape(len(residual), -1)

    def _of(self, residual: NDArray[np.complex128]) -> NDArray[np.float64]:
        """The same for one channel (S, antennas, tones)."""
        spectrum = self._weights @ scipy.fft.ifft(residual, self._bins, axis=2)
        energy = np.sum(spectrum.real**2 + spectrum.imag**2, axis=0)
        direction, delay = np.unravel_index(int(np.argmax(energy)), energy.shape)
        return np.concatenate([[delay / self._bins], self._turns[direction]])


def _visible(array_shape: tuple[int, ...], spacings: tuple[float, ...]) -> NDArray[np.float64]:
    """Directions searched, shape (n, axes), in turns: none are longer than the spacing of the elements."""
    turns = np.zeros((1, 0))
    for size, spacing in zip(array_shape, spacings, strict=True):
        reach = min(spacing, 0.5)
        points = 2 * int(np.ceil(_ARRAY_OVERSAMPLING * size * reach)) + 1
        axis = np.linspace(-reach, reach, points)
        turns = np.column_stack([np.repeat(turns, points, axis=0), np.tile(axis, len(turns))])
    return np.asarray(turns[np.linalg.norm(turns / np.array(spacings), axis=1) <= 1.1])
