"""The strongest atom in a residual: an oversampled grid over delays and directions.

The channel's correlations on the grid come from one FFT; those of the residual follow by taking off the
paths, whose correlations on the grid are products of Dirichlet kernels. Single precision is enough here:
a grid point is only where Newton's steps start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.channel.model import dirichlet_at, dirichlet_of
from estimator.compiled import compiled

__all__ = ["Grid", "GridCorrelations", "PeakSearch", "strongest"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Single = NDArray[np.float32]

_ARRAY_OVERSAMPLING = 2  # points per resolution cell of an array's axis
_PIECE = 1024  # grid points worked on at a time: what fits the processor's nearest cache


class Grid(NamedTuple):
    """Delays and directions searched; compiled functions take it as it is.

    Parameters
    ----------
    trigonometry : ndarray, shape (4, B)
        Of the B delays: sine and cosine of ``pi tones x``, and of ``pi x``.
    turns : ndarray, shape (T, D - 1)
        Directions, turns.
    sizes : ndarray of int64, shape (D,)
        Samples along each axis.
    """

    trigonometry: Real
    turns: Real
    sizes: NDArray[np.int64]


class GridCorrelations(NamedTuple):
    """A channel's correlations on the grid.

    Parameters
    ----------
    real, imaginary : ndarray of float32, shape (S, T, B)
        Their parts.
    """

    real: Single
    imaginary: Single


class PeakSearch:
    """The grid for a number of tones and an array.

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
        bins = scipy.fft.next_fast_len(oversampling * tones)
        delay = np.arange(bins) / bins
        angles = np.pi * np.array([tones, 1.0])[:, None] * delay
        trigonometry = np.stack([np.sin(angles), np.cos(angles)], axis=1).reshape(4, bins)
        turns = _visible(array_shape, spacings)
        self.grid = Grid(trigonometry, turns, np.array([tones, *array_shape], dtype=np.int64))
        places = np.indices(array_shape).reshape(len(array_shape), int(np.prod(array_shape)))
        middle = 0.5 * (np.array(array_shape, dtype=np.float64) - 1.0)
        self._weights = np.exp(2j * np.pi * turns @ (places - middle[:, None])).astype(np.complex64)
        self._phase = np.exp(-1j * np.pi * (tones - 1.0) * delay)  # tone numbers count from the middle

    def of(self, channel: Complex) -> GridCorrelations:
        """Correlations of a channel (S, antennas, tones) on the grid."""
        bins = self.grid.trigonometry.shape[1]
        spectrum = (scipy.fft.ifft(channel, bins, axis=2, norm="forward") * self._phase).astype(np.complex64)
        if len(self._weights) > 1:
            spectrum = self._weights @ spectrum
        return GridCorrelations(np.ascontiguousarray(spectrum.real), np.ascontiguousarray(spectrum.imag))


@compiled
def strongest(grid: Grid, channel: GridCorrelations, points: Real, gain: Complex, point: Real) -> None:
    """The grid point with the largest correlation energy of what paths leave of a channel.

    Parameters
    ----------
    grid : Grid
        Delays and directions.
    channel : GridCorrelations
        The channel.
    points, gain : ndarray, shape (K, D) and (S, K)
        The paths.
    point : ndarray, shape (D,)
        Where it goes, turns.
    """
    paths, bins, directions = points.shape[0], grid.trigonometry.shape[1], grid.turns.shape[0]
    kernel = np.empty((paths, bins), np.float32)
    for k in range(paths):
        _kernel_on_grid(grid, points[k, 0], kernel[k])
    best, delay, direction = np.int32(-1), 0, 0
    along = np.empty(paths)
    energy = np.empty(_PIECE, np.float32)
    real, imaginary = np.empty(_PIECE, np.float32), np.empty(_PIECE, np.float32)
    for t in range(directions):
        for k in range(paths):
            along[k] = 1.0
            for d in range(1, grid.sizes.size):
                along[k] *= dirichlet_at(grid.turns[t, d - 1] - points[k, d], grid.sizes[d])[0]
        for first in range(0, bins, _PIECE):
            count = min(_PIECE, bins - first)
            energy[:] = np.float32(0.0)
            for s in range(gain.shape[0]):
                for i in range(count):
                    real[i] = channel.real[s, t, first + i]
                    imaginary[i] = channel.imaginary[s, t, first + i]
                for k in range(paths):
                    row = kernel[k, first : first + count]
                    _take_off(row, np.float32(gain[s, k].real * along[k]), real)
                    _take_off(row, np.float32(gain[s, k].imag * along[k]), imaginary)
                for i in range(count):
                    energy[i] += real[i] * real[i] + imaginary[i] * imaginary[i]
            bits = energy.view(np.int32)  # of positive numbers, bits order as the numbers do
            largest = np.int32(-1)
            for i in range(count):
                largest = max(largest, bits[i])
            if largest > best:
                best, direction, delay = largest, t, first
                while bits[delay - first] != largest:
                    delay += 1
    point[0] = delay / bins
    for d in range(1, point.size):
        point[d] = grid.turns[direction, d - 1]


@compiled
def _kernel_on_grid(grid: Grid, turns: float, out: Single) -> None:
    """Dirichlet kernel of the grid's delays less ``turns``."""
    tones = grid.sizes[0]
    sn, cn = np.sin(np.pi * tones * turns), np.cos(np.pi * tones * turns)
    s1, c1 = np.sin(np.pi * turns), np.cos(np.pi * turns)
    trig = grid.trigonometry
    for i in range(out.size):
        bottom = trig[2, i] * c1 - trig[3, i] * s1
        out[i] = np.float32((trig[0, i] * cn - trig[1, i] * sn) / (bottom if bottom != 0.0 else 1.0))
    bins = out.size
    near = int(np.rint(turns * bins))  # where both sines may vanish
    place = near % bins
    out[place] = np.float32(
        dirichlet_of(
            place / bins - turns,
            tones,
            (trig[0, place] * cn - trig[1, place] * sn, trig[1, place] * cn + trig[0, place] * sn),
            (trig[2, place] * c1 - trig[3, place] * s1, trig[3, place] * c1 + trig[2, place] * s1),
        )[0]
    )


@compiled
def _take_off(row: Single, factor: np.float32, total: Single) -> None:
    """Take ``factor`` times a row off."""
    for i in range(row.size):
        total[i] -= factor * row[i]


def _visible(array_shape: tuple[int, ...], spacings: tuple[float, ...]) -> Real:
    """Directions searched, shape (n, axes), in turns: none are longer than the spacing of the elements."""
    turns = np.zeros((1, 0))
    for size, spacing in zip(array_shape, spacings, strict=True):
        reach = min(spacing, 0.5)
        points = 2 * int(np.ceil(_ARRAY_OVERSAMPLING * size * reach)) + 1
        axis = np.linspace(-reach, reach, points)
        turns = np.column_stack([np.repeat(turns, points, axis=0), np.tile(axis, len(turns))])
    return np.asarray(turns[np.linalg.norm(turns / np.array(spacings), axis=1) <= 1.1])
