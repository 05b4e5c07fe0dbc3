"""Timing jitter and calibration errors: what they shift, and how their draws are spread."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid
from raytrace.radio.impairments import jitter, miscalibrate

GRID = OfdmGrid(28e9, 480e3, 64)


def delays(ratio: np.ndarray) -> np.ndarray:
    """Delay that turns the tones of a ratio, from the phase steps between neighbours."""
    step = np.angle(np.mean(ratio[..., 1:] * ratio[..., :-1].conj(), axis=-1))
    return -step / (2 * np.pi * GRID.tone_spacing_hz)


def test_jitter_delays_whole_channels() -> None:
    """All paths and antennas of one CFR share one delay; its spread is the one stated."""
    rng = np.random.default_rng(1)
    response = rng.standard_normal((500, 2, 3, 64)) + 1j * rng.standard_normal((500, 2, 3, 64))
    shift = delays(jitter(response, GRID, 2e-10, rng) / response)
    np.testing.assert_allclose(shift, shift[..., :1] * np.ones(3), atol=1e-18)
    draws = shift[..., 0].ravel()
    assert abs(draws.mean()) < 5 * 2e-10 / np.sqrt(draws.size)
    assert draws.std() == pytest.approx(2e-10, rel=5 / np.sqrt(2 * draws.size))


def test_ideal_radio_is_left_alone() -> None:
    """Zero errors change nothing."""
    rng = np.random.default_rng(2)
    passive, echo = np.ones((4, 2, 1, 64), complex), np.ones((1, 8, 64), complex)
    np.testing.assert_array_equal(jitter(passive, GRID, 0.0, rng), passive)
    np.testing.assert_array_equal(miscalibrate(echo, GRID, 0.0, 0.0, 0.0, rng), echo)


def test_beams_keep_their_errors_over_sweeps() -> None:
    """A beam's gain and phase error is the same in every sweep, and spread as stated."""
    response = np.ones((3, 4000, 64), complex)
    seen = miscalibrate(response, GRID, 0.5, 0.1, 0.0, np.random.default_rng(3))
    np.testing.assert_array_equal(seen[0], seen[2])
    gain_db, phase = 20 * np.log10(np.abs(seen[0, :, 0])), np.angle(seen[0, :, 0])
    assert gain_db.std() == pytest.approx(0.5, rel=5 / np.sqrt(8000))
    assert phase.std() == pytest.approx(0.1, rel=5 / np.sqrt(8000))


def test_front_end_shifts_all_ranges_alike() -> None:
    """The range error is one delay of all beams, twice the range over c, of the stated spread."""
    response = np.ones((1, 5, 64), complex)
    ranges = []
    for seed in range(400):
        seen = miscalibrate(response, GRID, 0.0, 0.0, 0.03, np.random.default_rng(seed))
        shift = delays(seen[0]) * SPEED_OF_LIGHT_M_S / 2
        np.testing.assert_allclose(shift, shift[0], atol=1e-9)
        ranges.append(shift[0])
    assert np.std(ranges) == pytest.approx(0.03, rel=5 / np.sqrt(800))
