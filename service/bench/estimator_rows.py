"""What the estimator costs: SLAM, channel estimation and active sensing, CPU time on one core."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import BeamSet, UniformLinearArray
from estimator.channel.model import delay_atoms
from estimator.channel.nomp import NompPlan
from estimator.sensing.flash import find_flashes
from estimator.sensing.linefit import fit_lines
from estimator.sensing.ranges import sweep_response
from estimator.threads import one_blas_thread
from estimator.waveform import OfdmGrid
from service.bench.floors import line_fits_s, spectrum_s
from service.bench.rows import Row, cpu_s
from service.bench.slam_rows import growth_rows, request_rows, step_rows

__all__ = ["rows"]

_BATCH, _ARRAY_BATCH, _ELEMENTS, _PATHS, _FITS = 64, 8, 16, 15, 1000
_NOMP_BAR_MS, _ARRAY_BAR_MS, _SWEEP_BAR_MS = 2.0, 15.0, 20.0
_SPECTRUM = "floor: one FFT of the same data"
_GRID = OfdmGrid(28e9, 120e3, 3276, comb=4, symbols=14)


def rows(quick: bool) -> Iterator[Row]:
    """Measure row by row.

    Parameters
    ----------
    quick : bool
        Fewer repetitions: seconds rather than a minute.
    """
    with one_blas_thread():
        yield from step_rows(quick)
        yield from growth_rows(quick)
        if not quick:
            yield from request_rows()
        repeats = 1 if quick else 7
        yield _nomp(repeats)
        yield _nomp_array(repeats)
        yield _flash(repeats)
        yield _line_fit(repeats)


def _nomp(repeats: int) -> Row:
    """Delays of channels with 15 paths over 28 dB, in a batch."""
    cfr = _channels(_BATCH, None)
    plan = NompPlan(_GRID)
    taken = cpu_s(lambda: plan.estimate(cfr, 1e-4), repeats)
    name = f"NOMP, {_GRID.tones} tones, {_PATHS} paths, batches of {_BATCH}: channel"
    return Row(name, 1e3 * taken / _BATCH, "ms", _NOMP_BAR_MS, _SPECTRUM, 1e3 * spectrum_s(cfr) / _BATCH)


def _nomp_array(repeats: int) -> Row:
    """Delays and azimuths of the same paths at a linear array, in a batch."""
    array = UniformLinearArray(_ELEMENTS)
    cfr = _channels(_ARRAY_BATCH, array)
    plan = NompPlan(_GRID, array=array)
    taken = cpu_s(lambda: plan.estimate(cfr, 1e-4), repeats)
    name = (
        f"NOMP, {_GRID.tones} tones, {_ELEMENTS} antennas, {_PATHS} paths, batches of {_ARRAY_BATCH}: channel"
    )
    floor = 1e3 * spectrum_s(cfr) / _ARRAY_BATCH
    return Row(name, 1e3 * taken / _ARRAY_BATCH, "ms", _ARRAY_BAR_MS, _SPECTRUM, floor)


def _channels(count: int, array: UniformLinearArray | None) -> NDArray[np.complex128]:
    """Channels of 15 paths over 28 dB, at an array from directions all in front, with their noise."""
    rng = np.random.default_rng(1)
    shape = (count, _PATHS)
    cells = np.sort(rng.uniform(10.0, 200.0, shape), axis=1) + 1.5 * np.arange(_PATHS)
    amplitude = rng.permuted(np.tile(10.0 ** (-0.1 * np.arange(_PATHS)), (count, 1)), axis=1)
    gain = amplitude * np.exp(2j * np.pi * rng.uniform(size=shape))
    atoms = delay_atoms(_GRID, cells * _GRID.resolution_s)
    if array is None:
        cfr = np.einsum("ck,ckn->cn", gain, atoms)
    else:
        steering = array.steering(rng.uniform(-1.2, 1.2, shape))
        cfr = np.einsum("ck,cka,ckn->can", gain, steering, atoms, optimize=True)
    noise = np.sqrt(0.5e-4) * (rng.normal(size=cfr.shape) + 1j * rng.normal(size=cfr.shape))
    return np.asarray(cfr + noise, dtype=np.complex128)


def _flash(repeats: int) -> Row:
    """Walls from the flashes of a sweep of 64 beams in a room of four walls."""
    rng = np.random.default_rng(1)
    beams = BeamSet(panels=4, elements=16, beams=64)
    azimuth, distance = np.deg2rad([180.0, -90.0, 90.0, 0.0]), np.array([10.0, 15.0, 25.0, 70.0])
    noise = _GRID.noise_variance(10.0, 7.0)
    amplitude = 0.4 * _GRID.wavelength_m / (8.0 * np.pi * distance)
    echo = sweep_response(_GRID, beams, azimuth, distance, amplitude)
    echo = echo + np.sqrt(0.5 * noise) * (rng.normal(size=echo.shape) + 1j * rng.normal(size=echo.shape))
    taken = cpu_s(lambda: find_flashes(echo, noise, _GRID, beams), repeats)
    name = f"flashes, 64 beams, {_GRID.tones} tones, 4 walls: sweep"
    return Row(name, 1e3 * taken, "ms", _SWEEP_BAR_MS, _SPECTRUM, 1e3 * spectrum_s(echo))


def _line_fit(repeats: int) -> Row:
    """Maximum-likelihood walls through 16 ranges each."""
    rng = np.random.default_rng(1)
    azimuth = np.linspace(-0.9, 0.9, 16)
    distance = 10.0 / np.cos(azimuth) + 0.2 * rng.normal(size=(_FITS, 16))
    taken = cpu_s(lambda: fit_lines(distance, 0.2, azimuth), repeats)
    points = distance[..., None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    name, peer = f"line fit, 16 ranges, batches of {_FITS}: wall", "total least squares, same points"
    return Row(name, 1e6 * taken / _FITS, "us", None, peer, 1e6 * line_fits_s(points) / _FITS)
