"""Stated radio errors against what they do to channels."""

from __future__ import annotations

import numpy as np

from estimator.waveform import OfdmGrid
from raytrace.impairments import jitter, miscalibrate

GRID = OfdmGrid(28e9, 120e3, 800, comb=4)


def delays_of(channel):
    """Delay of a single path (.., tones) from the phase between neighbouring tones, seconds."""
    step = np.sum(channel[..., 1:] * channel[..., :-1].conj(), axis=-1)
    return -np.angle(step) / (2.0 * np.pi * GRID.tone_spacing_hz)


def test_jitter_shifts_all_paths_of_an_epoch_alike():
    """Timing errors have the stated spread, one for each epoch and anchor, shared by its antennas."""
    clean = np.broadcast_to(np.exp(-2j * np.pi * 50e-9 * GRID.offsets_hz()), (2000, 2, 2, GRID.tones))
    shifted = delays_of(jitter(clean, GRID, 1e-9, np.random.default_rng(1))) - 50e-9
    assert np.allclose(shifted[..., 0], shifted[..., 1], atol=1e-13)
    assert abs(np.std(shifted[..., 0]) / 1e-9 - 1.0) < 4.0 / np.sqrt(2.0 * 4000)
    assert abs(np.corrcoef(shifted[:, 0, 0], shifted[:, 1, 0])[0, 1]) < 4.0 / np.sqrt(2000)


def test_no_jitter_changes_nothing():
    """An ideal clock leaves the channels as they are."""
    clean = np.ones((3, 2, 1, GRID.tones), dtype=np.complex128)
    assert np.array_equal(jitter(clean, GRID, 0.0, np.random.default_rng(2)), clean)


def test_beams_keep_their_errors_over_sweeps():
    """Gains and phases differ between beams as stated, and are the same in every sweep."""
    clean = np.ones((2, 4000, GRID.tones), dtype=np.complex128)
    heard = miscalibrate(clean, GRID, 0.5, 0.1, 0.0, np.random.default_rng(3))
    assert np.array_equal(heard[0], heard[1])
    factor = heard[0, :, 0]
    assert abs(np.std(20.0 * np.log10(np.abs(factor))) / 0.5 - 1.0) < 4.0 / np.sqrt(8000)
    assert abs(np.std(np.angle(factor)) / 0.1 - 1.0) < 4.0 / np.sqrt(8000)


def test_a_delay_error_moves_every_range_alike():
    """The front end's delay error is one range for all beams and sweeps, there and back."""
    clean = np.ones((2, 8, GRID.tones), dtype=np.complex128)
    moved = [
        delays_of(miscalibrate(clean, GRID, 0.0, 0.0, 0.03, np.random.default_rng(seed)))
        for seed in range(400)
    ]
    ranges = np.array(moved) * 299_792_458.0 / 2.0
    assert np.ptp(ranges, axis=(1, 2)).max() < 1e-9
    assert abs(np.std(ranges[:, 0, 0]) / 0.03 - 1.0) < 4.0 / np.sqrt(2.0 * 400)
