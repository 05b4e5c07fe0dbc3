"""OFDM grids, noise power and free-space loss, from first principles."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.errors import ConfigurationError
from estimator.waveform import (
    BOLTZMANN_J_PER_K,
    SPEED_OF_LIGHT_M_S,
    OfdmGrid,
    free_space_loss_db,
    frequency_response,
    impulse_response,
)

GRID = OfdmGrid(carrier_hz=28e9, subcarrier_spacing_hz=120e3, subcarriers=3276, comb=4, symbols=12)


def test_sizes_of_the_400_mhz_grid() -> None:
    """Tones, spacing, bandwidth, resolution and ambiguity of 3276 subcarriers of 120 kHz, comb 4."""
    assert GRID.tones == 819
    assert GRID.tone_spacing_hz == 480e3
    assert GRID.bandwidth_hz == pytest.approx(393.12e6)
    assert GRID.resolution_s * SPEED_OF_LIGHT_M_S == pytest.approx(0.7626, abs=1e-4)
    assert GRID.unambiguous_s * SPEED_OF_LIGHT_M_S == pytest.approx(624.57, abs=0.01)
    assert GRID.wavelength_m == pytest.approx(0.010707, abs=1e-6)


@pytest.mark.parametrize("tones", [8, 9])
def test_offsets_are_centred_and_ascending(tones: int) -> None:
    """Tone offsets have mean zero and equal steps, for even and odd numbers of tones."""
    offsets = OfdmGrid(1e9, 1e4, tones).offsets_hz()
    assert offsets.shape == (tones,)
    assert offsets.mean() == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(np.diff(offsets), 1e4)


def test_subcarriers_that_fill_no_tone_are_left_out() -> None:
    """A comb of 4 on 11 subcarriers has two tones."""
    assert OfdmGrid(1e9, 1e4, 11, comb=4).tones == 2


def test_free_space_loss_is_friis() -> None:
    """The loss is that of Friis: 32.45 dB at 1 km and 1 MHz (textbook), 6.02 dB per doubling."""
    loss = free_space_loss_db(np.array([1000.0, 2000.0]), 1e6)
    assert loss[0] == pytest.approx(32.45, abs=5e-3)
    assert loss[1] - loss[0] == pytest.approx(20.0 * np.log10(2.0))


def test_noise_of_a_sampled_link() -> None:
    """The stated variance is that of thermal noise added to symbols of a shared power, then averaged."""
    grid = OfdmGrid(1e9, 15e3, subcarriers=64, comb=2, symbols=4)
    power_w, noise_figure_db = 2.0, 5.0
    rng = np.random.default_rng(1)
    amplitude = np.sqrt(power_w / grid.tones)  # each tone's share
    noise_w = BOLTZMANN_J_PER_K * 290.0 * 15e3 * 10.0 ** (noise_figure_db / 10.0)
    runs = 4000
    shape = (runs, grid.symbols, grid.tones)
    received = amplitude * 1.0 + np.sqrt(noise_w / 2.0) * (
        rng.normal(size=shape) + 1j * rng.normal(size=shape)
    )
    estimate = (received / amplitude).mean(axis=1)
    measured = np.mean(np.abs(estimate - 1.0) ** 2)
    stated = grid.noise_variance(10.0 * np.log10(power_w) + 30.0, noise_figure_db)
    assert measured == pytest.approx(stated, rel=4.0 / np.sqrt(runs * grid.tones))


def test_noise_in_decibels() -> None:
    """One subcarrier of 120 kHz has -174 + 50.8 + 7 = -116.2 dBm of noise; 26 dBm are shared by 819 tones."""
    noise_dbm = 10.0 * np.log10(GRID.noise_variance(26.0, 7.0)) + 26.0 - 10.0 * np.log10(819 / 12)
    assert noise_dbm == pytest.approx(-116.18, abs=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"carrier_hz": 0.0}, "OfdmGrid.carrier_hz: expected a positive number, got 0"),
        ({"subcarrier_spacing_hz": float("nan")}, "OfdmGrid.subcarrier_spacing_hz: .* got nan"),
        ({"symbols": -1}, "OfdmGrid.symbols: expected a positive number, got -1"),
        ({"subcarriers": 7}, r"at least two tones \(8 subcarriers at comb 4\), got 7"),
    ],
)
def test_bad_grids_are_refused(change: dict[str, float], message: str) -> None:
    """The field, what was expected and what came are named."""
    fields = {
        "carrier_hz": 28e9,
        "subcarrier_spacing_hz": 120e3,
        "subcarriers": 3276,
        "comb": 4,
        "symbols": 12,
    }
    with pytest.raises(ConfigurationError, match=message):
        OfdmGrid(**{**fields, **change})


def test_taps_are_the_inverse_of_tones() -> None:
    """Back and forth gives the CFR again; a path on a tap is that tap alone, with its amplitude."""
    grid = OfdmGrid(28e9, 120e3, 3276, comb=4)
    rng = np.random.default_rng(8)
    cfr = rng.standard_normal((3, 2, grid.tones)) + 1j * rng.standard_normal((3, 2, grid.tones))
    np.testing.assert_allclose(frequency_response(impulse_response(cfr, grid), grid), cfr, atol=1e-12)
    delay = grid.taps_s()[17]
    cir = impulse_response(0.3j * np.exp(-2j * np.pi * grid.offsets_hz() * delay), grid)
    expected = np.zeros(grid.tones, dtype=np.complex128)
    expected[17] = 0.3j
    np.testing.assert_allclose(cir, expected, atol=1e-12)


def test_noise_on_taps() -> None:
    """Noise of variance v on every tone is noise of variance v / tones on every tap (Parseval)."""
    grid = OfdmGrid(28e9, 120e3, 400)
    rng = np.random.default_rng(9)
    noise = (rng.standard_normal((200, 400)) + 1j * rng.standard_normal((200, 400))) / np.sqrt(2.0)
    variance = np.mean(np.abs(impulse_response(noise, grid)) ** 2)
    assert variance == pytest.approx(1.0 / 400, rel=5 / np.sqrt(noise.size))
