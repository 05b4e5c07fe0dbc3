"""Bounds of ranges and the power laws, against the signal model itself."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.arrays import BeamSet
from estimator.errors import ConfigurationError, InputError
from estimator.sensing.ranges import (
    EchoLaw,
    echo_response,
    sweep_response,
    variance_exact,
    variance_honest,
    variance_published,
)
from estimator.waveform import SPEED_OF_LIGHT_M_S, OfdmGrid

PAPER = OfdmGrid(28e9, 120e3, 200)


def information(derivatives: np.ndarray, noise_variance: float) -> np.ndarray:
    """Fisher information (15) of parameters from the derivatives (P, N) of the signal."""
    return 2.0 / noise_variance * np.real(derivatives.conj() @ derivatives.T)


@pytest.mark.parametrize("exponent", [4.0, 2.0])
def test_exact_bound_is_the_inverse_information_of_the_signal(exponent):
    """(15) by differences of the signal (7) whose amplitude falls with the distance."""
    step, distance, snr = 1e-4, 12.0, 0.7

    def signal(d: float) -> np.ndarray:
        return echo_response(PAPER, d, (distance / d) ** (0.5 * exponent))

    slope = (signal(distance + step) - signal(distance - step)) / (2.0 * step)
    expected = 1.0 / information(slope[None], 1.0 / snr)[0, 0]
    assert variance_exact(PAPER, distance, snr, exponent) == pytest.approx(expected, rel=1e-6)


def test_unknown_gain_gives_theorem_1():
    """Eliminating a complex gain from the information leaves (16), up to 1 / N^2."""
    step, distance, snr = 1e-4, 12.0, 0.7
    slope = (echo_response(PAPER, distance + step) - echo_response(PAPER, distance - step)) / (2.0 * step)
    signal = echo_response(PAPER, distance)
    matrix = information(np.stack([slope, signal, 1j * signal]), 1.0 / snr)
    bound = np.linalg.inv(matrix)[0, 0]
    assert variance_honest(PAPER, snr) == pytest.approx(bound, rel=1e-6)
    assert variance_published(PAPER, snr) == pytest.approx(bound * (1.0 - 1.0 / PAPER.tones**2), rel=1e-6)


def test_amplitude_term_does_not_vanish_with_the_number_of_tones():
    """What (55) calls O(1/N) is 3 c^2 / (pi^2 d^2 B^2): 47 % at 10 m and 24 MHz, for any N."""
    term = 3.0 * SPEED_OF_LIGHT_M_S**2 / (np.pi * 10.0 * 24e6) ** 2
    assert term == pytest.approx(0.474, abs=0.001)
    for tones in (200, 2000, 20000):
        grid = OfdmGrid(28e9, 24e6 / tones, tones)
        excess = variance_published(grid, 1.0) / variance_exact(grid, 10.0, 1.0) - 1.0
        assert excess == pytest.approx(term, abs=3.0 / tones**2)


def test_power_laws_give_the_ranges_of_the_paper():
    """0 dB at 10 m: the d^-4 law's standard deviations at the walls of the paper's room, and d^-2's."""
    distance = np.array([10.0, 15.0, 25.0, 70.0])
    fourth = np.sqrt(variance_published(PAPER, EchoLaw().at(distance)))
    np.testing.assert_allclose(fourth, [0.172, 0.387, 1.08, 8.44], rtol=0.004)
    second = np.sqrt(variance_published(PAPER, EchoLaw(exponent=2.0).at(distance)))
    np.testing.assert_allclose(second, fourth[0] * distance / 10.0, rtol=1e-12)


def test_radar_law_is_the_power_of_the_echo():
    """Theorem 1's ratio is |b|^2 / (d^4 sigma^2) of (7), with the cross section's cosine."""
    wavelength, noise, gamma, eta = 0.0107, 1e-13, 1.3, 0.2
    law = EchoLaw.of_radar(wavelength, noise, gamma, eta)
    section = gamma * np.cos(0.6) ** (2 * eta)
    power = wavelength**2 * section / (4.0 * np.pi) ** 3 / 17.0**4
    assert law.at(17.0, 0.6) == pytest.approx(power / noise, rel=1e-12)
    assert law.at(17.0, 2.0) == 0.0


def test_sweep_weights_every_echo_by_the_beams():
    """(5), (6): the sum over RSPs of the two-way pattern times the response."""
    beams = BeamSet(panels=4, elements=8, beams=16)
    azimuth, distance, gain = np.array([0.1, 2.0]), np.array([9.0, 21.0]), np.array([1.0, 0.3j])
    expected = sum(
        np.outer(beams.two_way(a), g * echo_response(PAPER, d))
        for a, d, g in zip(azimuth, distance, gain, strict=True)
    )
    np.testing.assert_allclose(sweep_response(PAPER, beams, azimuth, distance, gain), expected, atol=1e-12)


def test_bad_laws_and_ranges_are_named():
    """Each wrong number is answered with its name."""
    with pytest.raises(ConfigurationError, match="snr: expected a positive number, got -1"):
        EchoLaw(snr=-1.0)
    with pytest.raises(ConfigurationError, match="eta"):
        EchoLaw(eta=np.nan)
    with pytest.raises(ConfigurationError, match="noise_variance"):
        EchoLaw.of_radar(0.01, 0.0)
    with pytest.raises(InputError, match="distance_m: expected positive numbers, got 0.0"):
        EchoLaw().at([1.0, 0.0])
    with pytest.raises(InputError, match="snr"):
        variance_published(PAPER, -1.0)
