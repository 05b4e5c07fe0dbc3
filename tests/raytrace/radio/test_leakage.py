"""Leakage of the transmitter into the echo's receiver: its power, delay and phase noise."""

from __future__ import annotations

import numpy as np
import pytest

from raytrace.plan.links import Echo
from raytrace.radio.leakage import leakage_response

ECHO = Echo(isolation_db=60.0, leakage_delay_s=1e-9, leakage_phase_noise_deg=2.0)


def leaked(echo: Echo, isolation_db: float, sweeps: int, device: int = 1, phases: int = 2) -> np.ndarray:
    return leakage_response(
        echo, isolation_db, sweeps, np.random.default_rng(device), np.random.default_rng(phases)
    )


def test_power_is_the_isolation() -> None:
    """The mean power over the beams of 60 dB of isolation is 1e-6, and 20 dB more are a hundredth."""
    power = np.mean(np.abs(leaked(ECHO, 60.0, 3)) ** 2)
    assert power == pytest.approx(1e-6, rel=2e-3)
    assert np.mean(np.abs(leaked(ECHO, 80.0, 3)) ** 2) == pytest.approx(1e-2 * power, rel=1e-9)


def test_all_power_arrives_at_the_delay() -> None:
    """Without phase noise every beam is one tone of a delay, the same in every sweep, and beams differ."""
    quiet = leaked(Echo(leakage_delay_s=1e-9, leakage_phase_noise_deg=0.0), 60.0, 2)
    np.testing.assert_array_equal(quiet[0], quiet[1])
    grid = ECHO.grid()
    turned = quiet[0] * np.exp(2j * np.pi * (grid.carrier_hz + grid.offsets_hz()) * 1e-9)
    np.testing.assert_allclose(turned, turned[:, :1] * np.ones(grid.tones), rtol=1e-9)
    assert np.std(np.abs(turned[:, 0])) > 0.2 * np.mean(np.abs(turned[:, 0]))


def test_phase_noise_is_common_and_between_tones() -> None:
    """Over sweeps a beam's phase spreads by what is stated; tones spread by that over the symbols' root."""
    sweeps = 100
    heard = (
        leaked(ECHO, 60.0, sweeps)[:, 5]
        / leaked(Echo(leakage_phase_noise_deg=0.0, leakage_delay_s=1e-9), 60.0, 1)[0, 5]
    )
    phase = np.angle(heard.mean(axis=1))
    assert np.rad2deg(np.std(phase)) == pytest.approx(2.0, rel=0.25)
    between = heard - heard.mean(axis=1, keepdims=True)
    expected = np.deg2rad(2.0) / np.sqrt(ECHO.symbols)
    assert np.sqrt(np.mean(np.abs(between) ** 2)) == pytest.approx(expected, rel=0.02)
