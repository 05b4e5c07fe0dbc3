"""Atoms, the Dirichlet kernel and correlations against direct sums over the tones."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.channel.model import ToneCorrelator, delay_atoms, dirichlet
from estimator.errors import InputError
from estimator.waveform import OfdmGrid


def tone_numbers(tones: int) -> np.ndarray:
    return np.arange(tones) - 0.5 * (tones - 1)


@pytest.mark.parametrize("tones", [2, 7, 200, 819])
def test_dirichlet_equals_the_sum_of_tones(tones: int) -> None:
    """Kernel and derivatives equal the sums they abbreviate: far, near zero, at and beyond whole turns."""
    rng = np.random.default_rng(1)
    x = np.concatenate(
        [rng.uniform(-2.0, 2.0, 200), rng.normal(0.0, 0.02 / tones, 100), rng.normal(0.0, 1e-9, 20)]
    )
    x = np.concatenate([x, [0.0, 1.0, -1.0, 0.5, 1e-2 / tones, 1.0 - 1e-2 / tones]])
    phase = 2j * np.pi * tone_numbers(tones)
    for m, kernel in enumerate(dirichlet(x, tones)):
        expected = np.sum(np.exp(phase * x[:, None]) * phase**m, axis=1)
        np.testing.assert_allclose(kernel, expected.real, rtol=0, atol=1e-11 * tones ** (m + 1))
        np.testing.assert_allclose(expected.imag, 0.0, atol=1e-8 * tones ** (m + 1))


@pytest.mark.parametrize("tones", [2, 33, 64, 819])
def test_correlations_and_sums_are_exact(tones: int) -> None:
    """The factorised correlation, its derivatives and the synthesis equal the direct sums."""
    rng = np.random.default_rng(2)
    cfr = rng.normal(size=(4, tones)) + 1j * rng.normal(size=(4, tones))
    turns = rng.uniform(-0.5, 1.5, (4, 3))
    gain = rng.normal(size=(4, 3)) + 1j * rng.normal(size=(4, 3))
    correlator = ToneCorrelator(tones)
    phase = 2j * np.pi * tone_numbers(tones)
    atoms = np.exp(phase * turns[..., None])
    for m, found in enumerate(correlator.correlate(correlator.split(cfr), turns)):
        expected = np.sum(atoms * phase**m * cfr[:, None, :], axis=2)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * tones ** (m + 1))
    expected = np.sum(gain[..., None] * atoms.conj(), axis=1)
    np.testing.assert_allclose(correlator.synthesise(turns, gain), expected, atol=1e-10)


def test_atoms_follow_the_cfr_convention() -> None:
    """An atom is exp(-j 2 pi f tau) on the grid's own tone offsets."""
    grid = OfdmGrid(28e9, 120e3, 40, comb=4)
    delay = np.array([[0.0, 1e-7], [2e-7, 3e-7]])
    atoms = delay_atoms(grid, delay)
    assert atoms.shape == (2, 2, 10)
    np.testing.assert_allclose(atoms[0, 0], 1.0)
    np.testing.assert_allclose(atoms[1, 1], np.exp(-2j * np.pi * grid.offsets_hz() * 3e-7))


def test_one_tone_carries_no_delay() -> None:
    """A correlator needs two tones, and says so."""
    with pytest.raises(InputError, match="at least 2, got 1"):
        ToneCorrelator(1)
